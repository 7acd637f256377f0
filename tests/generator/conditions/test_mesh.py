import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from toy_vehicle import toy_car

from dwgs.scene import InputError
from generator.conditions.points import load_vehicle

pytestmark = pytest.mark.usefixtures("few_samples")

Y_UP = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])  # glTF: +z forward, +x left


def save_glb(car: trimesh.Trimesh, path: Path) -> Path:
    car.copy().apply_transform(Y_UP).export(path)
    return path


def test_a_mesh_becomes_points_in_the_vehicle_frame(tmp_path: Path):
    vehicle, size, note = load_vehicle(save_glb(toy_car(), tmp_path / "car.glb"))
    np.testing.assert_allclose(size, [4.4, 1.8, 1.5], atol=1e-5)
    assert (np.abs(vehicle.points) <= size / 2 + 1e-4).all()
    assert vehicle.is_complete
    front = vehicle.points[:, 0] > 1.0
    assert (vehicle.colors[front] == (200, 0, 0)).all()
    assert note == "car.glb: metres (4.40 x 1.80 x 1.50 m), up +y, forward +z"


def test_what_nobody_can_see_from_outside_is_left_out(tmp_path: Path):
    vehicle, _, _ = load_vehicle(save_glb(toy_car(), tmp_path / "car.glb"))
    assert not (vehicle.colors == (0, 200, 0)).all(1).any()  # the seat
    underside = (np.abs(vehicle.points) < [2.1, 0.8, np.inf]).all(1) & (vehicle.points[:, 2] < -0.749)
    assert not underside.any()


def test_normals_point_outwards_even_where_faces_are_turned_inside_out(tmp_path: Path):
    car = toy_car()
    car.faces[::2] = car.faces[::2, ::-1]
    vehicle, _, _ = load_vehicle(save_glb(car, tmp_path / "car.glb"))
    assert vehicle.normals is not None
    side = np.abs(vehicle.points[:, 1]) > 0.9 - 1e-3
    assert side.sum() > 500
    outward = np.sign(vehicle.points[side, 1]) * vehicle.normals[side, 1]
    assert (outward > 0.9).mean() > 0.99


def test_loading_twice_gives_the_same_bytes(tmp_path: Path):
    path = save_glb(toy_car(), tmp_path / "car.glb")
    first, second = load_vehicle(path)[0], load_vehicle(path)[0]
    assert first.points.tobytes() == second.points.tobytes()
    assert first.colors.tobytes() == second.colors.tobytes()


def test_a_mesh_in_centimetres_along_another_axis_is_understood_and_said(tmp_path: Path):
    car = toy_car()
    car.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [0, 0, 1]))
    car.apply_scale(100)
    car.export(tmp_path / "car.stl")
    vehicle, size, note = load_vehicle(tmp_path / "car.stl")
    np.testing.assert_allclose(size, [4.4, 1.8, 1.5], atol=1e-4)
    assert vehicle.points[vehicle.points[:, 2] > 0.7, 0].mean() < -0.5  # the roof is behind the bonnet
    assert "centimetres (4.40 x 1.80 x 1.50 m), up +z, forward -y (unit and forward assumed" in note


def test_a_body_without_wheels_keeps_its_height_above_the_ground(tmp_path: Path):
    car = toy_car()
    car.apply_translation([0, 0, 0.15])
    _, size, note = load_vehicle(save_glb(car, tmp_path / "car.glb"))
    assert size[2] == pytest.approx(1.65, abs=1e-5)
    assert "15 cm above its own zero" in note


def textured_car(image: Image.Image | None, **material) -> trimesh.Trimesh:
    car = toy_car()
    uv = np.stack([(car.vertices[:, 0] + 2.2) / 4.4, np.full(len(car.vertices), 0.5)], 1)
    pbr = trimesh.visual.material.PBRMaterial(baseColorTexture=image, **material)
    car.visual = trimesh.visual.TextureVisuals(uv=uv, material=pbr)
    return car


def test_textures_are_sampled_and_multiplied_by_the_factor_as_light(tmp_path: Path):
    pixels = np.zeros((8, 64, 3), np.uint8)
    pixels[:, :32], pixels[:, 32:] = (255, 0, 0), (255, 255, 255)
    car = textured_car(Image.fromarray(pixels), baseColorFactor=[0.5, 1.0, 1.0, 1.0])
    vehicle, _, _ = load_vehicle(save_glb(car, tmp_path / "car.glb"))
    rear, front = vehicle.points[:, 0] < -0.3, vehicle.points[:, 0] > 0.3
    np.testing.assert_allclose(np.median(vehicle.colors[rear], 0), (188, 0, 0), atol=1)
    np.testing.assert_allclose(np.median(vehicle.colors[front], 0), (188, 255, 255), atol=1)


def test_translucent_glass_becomes_dark_and_opaque(tmp_path: Path):
    car = textured_car(None, baseColorFactor=[1.0, 1.0, 1.0, 0.1], alphaMode="BLEND")
    vehicle, _, _ = load_vehicle(save_glb(car, tmp_path / "car.glb"))
    assert vehicle.colors.max() < 60


def test_a_material_of_an_obj_is_used_and_a_missing_texture_is_said(tmp_path: Path):
    car = toy_car()
    car.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(car.vertices), 2)))
    car.export(tmp_path / "car.obj")
    (tmp_path / "material.mtl").write_text("newmtl material_0\nKd 1.0 0.5 0.0\nmap_Kd gone.png\n")
    vehicle, _, note = load_vehicle(tmp_path / "car.obj")
    np.testing.assert_array_equal(np.unique(vehicle.colors, axis=0), [[255, 128, 0]])
    assert "not found beside it, left out: gone.png" in note


def test_a_mesh_that_no_unit_makes_a_vehicle_is_refused(tmp_path: Path):
    trimesh.creation.icosphere(radius=3).export(tmp_path / "ball.ply")
    with pytest.raises(InputError, match=r"ball.ply measures \S+ x \S+ x \S+ \(x, y, z\) .* set --unit and --forward"):
        load_vehicle(tmp_path / "ball.ply")


def gltf(path: Path, **changes) -> Path:
    car = toy_car()
    car.visual = trimesh.visual.TextureVisuals()
    for name, data in trimesh.exchange.gltf.export_gltf(car.scene()).items():
        (path.parent / name).write_bytes(data)
    tree = json.loads((path.parent / "model.gltf").read_text())
    tree.update(changes)
    path.write_text(json.dumps(tree))
    return path


def test_references_outside_the_folder_are_refused(tmp_path: Path):
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(b"0" * 1000)
    path = gltf(folder / "car.gltf", buffers=[{"uri": "../secret.bin", "byteLength": 1000}])
    with pytest.raises(InputError, match=r"refers to '../secret.bin', which is not in its folder"):
        load_vehicle(path)


def test_counts_that_no_file_can_hold_are_refused_before_memory_is_asked_for(tmp_path: Path):
    huge = [{"componentType": 5126, "count": 10**12, "type": "VEC3"}]
    with pytest.raises(InputError, match="declares 1000000000000 items"):
        load_vehicle(gltf(tmp_path / "car.gltf", accessors=huge))
    stl = tmp_path / "car.stl"
    stl.write_bytes(b"\0" * 80 + (2**31).to_bytes(4, "little") + b"\0" * 50)
    with pytest.raises(InputError, match=r"cannot be read as a stl mesh|1 to 20000000 faces"):
        load_vehicle(stl)


@pytest.mark.parametrize(
    ("name", "content"), [("a.glb", b"glTF"), ("a.glb", b""), ("a.obj", b"f 1 2 3\n"), ("a.gltf", b"{")]
)
def test_a_broken_mesh_is_one_sentence(tmp_path: Path, name: str, content: bytes):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        load_vehicle(tmp_path / name)


def test_vertices_that_are_not_finite_are_refused(tmp_path: Path):
    car = toy_car()
    car.vertices[3, 1] = np.nan
    car.export(tmp_path / "car.stl")
    with pytest.raises(InputError, match="vertices are finite"):
        load_vehicle(tmp_path / "car.stl")


def test_an_unknown_format_and_a_missing_file_are_named(tmp_path: Path):
    (tmp_path / "car.fbx").write_bytes(b"x")
    with pytest.raises(InputError, match=r"one of .glb, .gltf, .obj.* not car.fbx"):
        load_vehicle(tmp_path / "car.fbx")
    with pytest.raises(InputError, match="there is none at"):
        load_vehicle(tmp_path / "nothing.glb")
