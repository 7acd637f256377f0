"""One text for both devices: a ``number`` is sixteen float32 side by side on a CPU, and one on a GPU.

Text for native snippets. Conditions are of type ``truth``; ``condition ? a : b`` chooses lane by lane.
"""

LANES = {"cpu": 16, "cuda": 1}
"""How many in a number."""

TRANSPOSE = """
    auto first_halves = [](auto a, auto b) {  // a0 b0 a1 b1 ... a7 b7
        return __builtin_shufflevector(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    };
    auto last_halves = [](auto a, auto b) {  // a8 b8 ... a15 b15
        return __builtin_shufflevector(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    };
    auto transpose = [&](auto* rows) -> void {  // sixteen rows of sixteen
        decltype(first_halves(rows[0], rows[0])) next[16];
        for (int round = 0; round < 4; ++round) {
            for (int k = 0; k < 8; ++k) {
                next[2 * k] = first_halves(rows[k], rows[k + 8]);
                next[2 * k + 1] = last_halves(rows[k], rows[k + 8]);
            }
            for (int k = 0; k < 16; ++k) rows[k] = next[k];
        }
    };
"""
"""For a CPU alone."""

NUMBERS = f"""
    #if defined(__CUDA_ARCH__)
    typedef float number;
    typedef double precise;
    typedef bool truth;
    const int lanes = 1;
    const number zero = 0.0f;
    auto any = [](truth m) -> bool {{ return m; }};
    auto root = [](number x) -> number {{ return sqrtf(x); }};
    auto logarithm = [](number x) -> number {{ return logf(x); }};
    auto exponential = [](number x) -> number {{ return expf(x); }};
    auto to_precise = [](number x) -> precise {{ return x; }};
    auto to_number = [](precise x) -> number {{ return (float)x; }};
    auto sum = [](number x) -> float {{ return x; }};
    #else
    #pragma clang fp contract(on)
    typedef float number __attribute__((vector_size(64)));
    typedef double precise __attribute__((vector_size(128)));
    typedef int truth __attribute__((vector_size(64)));
    const int lanes = 16;
    const number zero = {{}};
    auto any = [](truth m) -> bool {{ return __builtin_reduce_or(m) != 0; }};
    auto root = [](number x) -> number {{ return __builtin_elementwise_sqrt(x); }};
    auto logarithm = [](number x) -> number {{  // of positive numbers, good to an ulp
        typedef int whole __attribute__((vector_size(64)));
        const whole bits = (whole)x, exponent = (bits - 0x3f3504f3) >> 23;
        const number m = (number)(bits - (exponent << 23)), s = (m - 1.0f) / (m + 1.0f), z = s * s;
        const number series = (((z / 9.0f + 1.0f / 7) * z + 1.0f / 5) * z + 1.0f / 3) * z;
        return __builtin_convertvector(exponent, number) * 0.69314718f + (2.0f * s + 2.0f * s * series);
    }};
    auto exponential = [&](number x) -> number {{  // good to an ulp or two; the series is that of Cephes
        typedef int whole __attribute__((vector_size(64)));
        x = x < -87.0f ? zero - 87.0f : x > 88.0f ? zero + 88.0f : x;
        const number turns = x * 1.44269504f;
        const whole exponent = __builtin_convertvector(turns + (turns < 0.0f ? zero - 0.5f : zero + 0.5f), whole);
        const number n = __builtin_convertvector(exponent, number);
        const number r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
        number series = r * 1.9875691500e-4f + 1.3981999507e-3f;
        series = (series * r + 8.3334519073e-3f) * r + 4.1665795894e-2f;
        series = (series * r + 1.6666665459e-1f) * r + 5.0000001201e-1f;
        return (number)((whole)(series * r * r + r + 1.0f) + (exponent << 23));
    }};
    auto to_precise = [](number x) -> precise {{ return __builtin_convertvector(x, precise); }};
    auto to_number = [](precise x) -> number {{ return __builtin_convertvector(x, number); }};
    auto sum = [](number x) -> float {{
        float total = 0.0f;
        for (int i = 0; i < 16; ++i) total += x[i];
        return total;
    }};
    #endif
    auto only = [&](truth m, number x) -> number {{ return m ? x : zero; }};
    auto lower = [](number a, number b) -> number {{ return a < b ? a : b; }};
    auto higher = [](number a, number b) -> number {{ return a > b ? a : b; }};
    auto finite = [&](number x) -> truth {{ return x - x == zero; }};

    // column k of rows of ``width`` floats, from row i on; rows from ``end`` on are the last one once more, or kept
    auto get = [](const void* rows, int width, int k, int i, int end) -> number {{
        const float* data = (const float*)rows;
        #if defined(__CUDA_ARCH__)
        return data[i * (long long)width + k];
        #else
        number column;
        if (i + 16 <= end) for (int l = 0; l < 16; ++l) column[l] = data[(i + l) * (long long)width + k];
        else for (int l = 0; l < 16; ++l) column[l] = data[(i + l < end ? i + l : end - 1) * (long long)width + k];
        return column;
        #endif
    }};
    auto put = [](void* rows, int width, int k, int i, int end, number column) -> void {{
        float* data = (float*)rows;
        #if defined(__CUDA_ARCH__)
        data[i * (long long)width + k] = column;
        #else
        for (int l = 0; l < 16 && i + l < end; ++l) data[(i + l) * (long long)width + k] = column[l];
        #endif
    }};

    // rows of sixteen floats as their columns
    #if !defined(__CUDA_ARCH__)
{TRANSPOSE}
    #endif
    auto get_rows = [&](const void* rows, int i, int end, number* columns) -> void {{
        const float* data = (const float*)rows + i * 16ll;
        #if defined(__CUDA_ARCH__)
        for (int k = 0; k < 16; ++k) columns[k] = data[k];
        #else
        for (int l = 0; l < 16; ++l) __builtin_memcpy(columns + l, data + (i + l < end ? l : 0) * 16, sizeof(number));
        transpose(columns);
        #endif
    }};
    auto put_rows = [&](void* rows, int i, int end, number* columns) -> void {{  // columns are used up
        float* data = (float*)rows + i * 16ll;
        #if defined(__CUDA_ARCH__)
        for (int k = 0; k < 16; ++k) data[k] = columns[k];
        #else
        transpose(columns);
        for (int l = 0; l < 16 && i + l < end; ++l) __builtin_memcpy(data + l * 16, columns + l, sizeof(number));
        #endif
    }};
"""
