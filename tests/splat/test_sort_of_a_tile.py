"""The text that sorts a tile on a GPU, run by threads that play its block: no GPU is needed to trust it."""

import shutil
import subprocess

import pytest

from dwgs.splat.kernels import bin_cuda

BLOCK = """
#include <algorithm>
#include <barrier>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <thread>
#include <vector>

template <class T> struct array { T* data; };
typedef unsigned long long u64;

const int threads = SORTERS;
std::barrier<> block(threads);
std::barrier<>* warps[threads / 32];
u64 lanes[threads];
thread_local int own;
void __syncthreads() { block.arrive_and_wait(); }
u64 __shfl_xor_sync(unsigned, u64 value, int other) {
    lanes[own] = value;
    warps[own / 32]->arrive_and_wait();
    value = lanes[own ^ other];
    warps[own / 32]->arrive_and_wait();
    return value;
}

#define __CUDA_ARCH__
#define __shared__ static
void sort_tile(int tile, int thread, array<int> tile_ends, array<u64> keys, array<u64> spare_keys, array<int> isects) {
SORT
}

int main(int, char** arguments) {
    const int count = std::atoi(arguments[1]), begin = 7, room = begin + count + 5;
    for (auto& warp : warps) warp = new std::barrier<>(32);
    std::mt19937_64 random(count);
    std::vector<int> order(count), isects(room, -1), tile_ends{begin, begin + count};
    for (int i = 0; i < count; ++i) order[i] = i;
    std::shuffle(order.begin(), order.end(), random);
    std::vector<u64> keys(room), spare(room);  // few depths, so that many are equal
    for (int i = 0; i < count; ++i) keys[begin + i] = random() % 50 << 32 | order[i];
    std::vector<u64> sorted(keys.begin() + begin, keys.begin() + begin + count);
    std::sort(sorted.begin(), sorted.end());
    std::vector<std::thread> sorters;
    for (int i = 0; i < threads; ++i)
        sorters.emplace_back([&, i] {
            own = i;
            sort_tile(1, i, {tile_ends.data()}, {keys.data()}, {spare.data()}, {isects.data()});
        });
    for (auto& sorter : sorters) sorter.join();
    bool is_right = true;
    for (int i = 0; i < room; ++i) {
        const bool is_inside = i >= begin && i < begin + count;
        is_right &= isects[i] == (is_inside ? (int)(sorted[i - begin] & 0xffffffff) : -1);
    }
    return !is_right;
}
"""


@pytest.fixture(scope="module")
def sort(tmp_path_factory):
    """A program that sorts so many keys, and succeeds where they are in order."""
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler: what sorts a tile on a GPU is not tried")
    folder = tmp_path_factory.mktemp("sort")
    text = BLOCK.replace("SORTERS", str(bin_cuda.SORTERS)).replace("SORT\n", bin_cuda.SORT)
    (folder / "sort.cpp").write_text(text)
    command = [compiler, "-std=c++20", "-O1", "-pthread", "-o", folder / "sort", folder / "sort.cpp"]
    build = subprocess.run(command, capture_output=True, text=True)
    if "-std=c++20" in build.stderr or "barrier" in build.stderr:
        pytest.skip("no C++20 compiler: what sorts a tile on a GPU is not tried")
    assert build.returncode == 0, build.stderr
    return folder / "sort"


@pytest.mark.parametrize("count", [0, 1, 2, 31, 32, 33, 255, 257, 1000, 2816, 2817, 5000])
def test_keys_come_out_in_order(sort, count):
    assert subprocess.run([sort, str(count)]).returncode == 0
