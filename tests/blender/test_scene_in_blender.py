"""The scene as Blender itself has it: curves, places, markers, pictures."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from blender_scenes import SINGLE, Seen, assert_curves_hold, blender_on_the_path, bpy_python, look, run_inside
from exporter_tables import drive, fixes, happened

from recon.manifest import RunInfo
from recon.numerics.rotation import from_euler, to_matrix
from recon.rows import Metric, metrics
from recon.tables import matrix, replace, with_meta
from recon_exporters.blender import BlenderParams, blender, find_blender

SLOW_FRAME, SOLVED_FRAME, FAST_FRAME = 26, 140, 201
HANDOVER, FPS = 26, 25


def a_drive():
    """Ten seconds that gain speed on a curve uphill, nose up as the slope is, with a quaternion that changes sign."""
    t_s = np.arange(0.0, 10.001, 0.01)
    speed, yaw, pitch = 2.0 + 1.8 * t_s, 0.15 * t_s, np.full(len(t_s), -0.05)
    velocity = speed[:, None] * np.column_stack((np.cos(yaw), np.sin(yaw), np.full(len(t_s), 0.05)))
    position = np.cumsum(velocity, axis=0) * 0.01 + (300.0, -200.0, 40.0)
    q = from_euler(yaw, pitch, 0.0) * np.where(np.arange(len(t_s)) % 300 < 150, 1.0, -1.0)[:, None]
    anchor = {"lat": 44.5, "lon": 11.3, "height": 100.0}
    std = np.full((len(t_s), 3), 0.1)
    return with_meta(drive(t_s, pos=position, vel=velocity, q=q, pos_std=std), anchor=anchor, earth="wgs84")


@pytest.fixture(scope="module", params=[bpy_python, blender_on_the_path])
def program(request) -> str:
    return request.param()


@pytest.fixture(scope="module")
def seen(program, tmp_path_factory) -> Seen:
    folder = tmp_path_factory.mktemp("scene")
    trajectory = a_drive()
    paths = blender(
        trajectory=trajectory,
        gnss=fixes(np.arange(0.0, 4.0, 1.0), lat=np.full(4, 44.4982), lon=11.3038 + 2e-5 * np.arange(4.0)),
        events=pa.concat_tables(
            [
                happened((8.0, 8.1), kind="crash", value=50.0, unit="m/s^2"),
                happened((8.0, 8.1), kind="impact", value=30.0, unit="km/h"),
            ]
        ),
        streams={
            "reference": replace(trajectory, pos=matrix(trajectory, "pos") + np.array([0.0, 0.0, 30.0])),
            "metrics": metrics([Metric("pdof", 60.0, "deg")]),
        },
        folder=folder,
        about=RunInfo("a drive"),
        params=BlenderParams(blender=program, ghost="reference", tube=2.0, slow_motion=1.0),
    )
    assert folder / "scene.blend" in paths
    assert not list(folder.rglob("__pycache__"))
    return look(find_blender(program), folder, SLOW_FRAME, FAST_FRAME)


def test_curves_hold_the_trajectory_at_every_key(seen):
    assert_curves_hold(seen, a_drive())


def test_wheels_and_display_are_animated_by_the_same_keys(seen):
    for name, values in (
        ("wheel rear left rotation_euler 1", seen.arrays["wheel_angle"]),
        ("hub front right rotation_euler 2", seen.arrays["steering"]),
        ('numbers nodes["speed"].outputs[0].default_value 0', 3.6 * seen.arrays["speed"]),
        ('numbers nodes["time"].outputs[0].default_value 0', seen.arrays["elapsed"]),
        ('vehicle ["speed"] 0', seen.arrays["speed"]),
        ("ghost location 2", seen.arrays["ghost_position"][:, 2]),
    ):
        assert np.abs(seen.curves[name][:, 1] - values).max() <= SINGLE * np.abs(values).max(), name


def test_the_vehicle_stands_where_the_trajectory_says_with_its_nose_and_roof_there(seen):
    for frame in (SLOW_FRAME, FAST_FRAME):
        pose = np.array(seen.facts["moments"][str(frame)]["vehicle"])
        row = np.searchsorted(seen.arrays["frame"], frame - 1e-6)
        # Frames of 0.04 s fall on rows of 0.01 s; a matrix is made of products of four roundings.
        assert np.abs(pose[:3, 3] - seen.arrays["position"][row]).max() < 1e-4
        assert np.abs(pose[:3, :3] - to_matrix(seen.arrays["q"][row])).max() < 1e-4


def test_the_file_tells_its_length_its_events_and_where_on_the_earth_it_is(seen):
    assert (seen.facts["fps"], seen.facts["frames"]) == (25, [1, 251])
    assert seen.facts["markers"] == [["outage 7.0 s", 76], ["crash 50.0 m/s²", 201], ["impact 30.0 km/h", 201]]
    assert seen.facts["camera"] == "camera follow"
    told = seen.facts["properties"]
    assert [told[name] for name in ("anchor_lat", "anchor_lon", "anchor_height")] == [44.5, 11.3, 100.0]
    assert told["origin"] == seen.plan["origin"]
    assert told["start"] == "2024-05-01T08:00:00.000Z"


def test_everything_that_is_promised_is_in_the_scene(seen):
    cameras = {f"camera {name}" for name in ("follow", "top", "driver", "overview")}
    parts = {"vehicle", "ghost", "body", "path", "ground", "strip", "sun", "GNSS fixes", "doubt"}
    assert cameras | parts <= set(seen.facts["objects"])


def test_what_the_display_writes_changes_with_the_speed(seen):
    slow, fast = (np.array(seen.facts["moments"][str(frame)]["letters"]) for frame in (SLOW_FRAME, FAST_FRAME))
    assert len(slow)
    assert slow.shape != fast.shape or not np.array_equal(slow, fast)
    # Letters 0.040 high, of a plate that is 0.235 wide and 0.13 high.
    assert (np.ptp(fast[:, 1]) < 0.13, 0.03 < np.ptp(fast[:, 0]) < 0.235) == (True, True)


def test_far_from_the_origin_the_display_reads_as_near_it_and_the_overview_sees_the_ground(program, tmp_path):
    """36 km straight on at 40 m/s: beside each other the pictures at 1 s and at 200 s, 8 km on, differ in the time."""
    t_s = np.arange(0.0, 900.0, 0.1)
    place = 40.0 * np.outer(t_s, (1.0, 0.0, 0.0))
    table = drive(t_s, pos=place, vel=np.gradient(place, t_s, axis=0), q=from_euler(0.0 * t_s, 0.0, 0.0))
    params = BlenderParams(blender=program)
    blender(trajectory=table, gnss=None, events=None, streams={}, folder=tmp_path, about=RunInfo("far"), params=params)
    seen = look(find_blender(program), tmp_path, 26, 5001)
    near, far = (seen.picture(frame)[132:146, 8:54] for frame in (26, 5001))  # the speed, 144 km/h
    assert near.max() - near.min() > 0.5
    assert np.abs(far - near).mean() < 0.1 * np.abs(near - near.mean()).mean()
    clip_end, height = seen.facts["overview"]
    assert clip_end > height + 100.0


def test_from_above_the_squares_of_a_slope_are_those_of_a_plain(program, tmp_path):
    """10 % uphill from the origin on: a pattern in space would change its colours where the ground rises above 0."""
    t_s = np.arange(0.0, 10.0, 0.1)
    place = 10.0 * np.outer(t_s, (1.0, 0.0, 0.1))
    table = drive(t_s, pos=place, vel=np.gradient(place, t_s, axis=0), q=from_euler(0.0 * t_s, -0.1, 0.0))
    north = {}
    for vertical in (True, False):
        folder = tmp_path / str(vertical)
        folder.mkdir()
        params = BlenderParams(blender=program, camera="top", vertical=vertical)
        blender(trajectory=table, gnss=None, events=None, streams={}, folder=folder, about=RunInfo("up"), params=params)
        north[vertical] = look(find_blender(program), folder, 1).picture(1)[:34].mean(axis=(0, 2))
        north[vertical] -= north[vertical].mean()
    assert np.corrcoef(north[True], north[False])[0, 1] > 0.9


def test_a_picture_shows_the_car_upright_in_its_middle_under_a_bright_sky(seen):
    picture = seen.picture(FAST_FRAME)
    red, green, blue = np.moveaxis(picture, -1, 0)
    paint = (blue > 0.25) & (blue > 2.5 * red) & (blue > 1.2 * green)
    rows, columns = np.nonzero(paint)
    assert len(rows) > 300
    assert (60 < rows.mean() < 140, 110 < columns.mean() < 210) == (True, True)
    tail_lamp = (red > 0.4) & (red > 2.5 * green) & (red > 2.5 * blue)
    assert tail_lamp.sum() > 10
    assert np.nonzero(tail_lamp)[0].mean() > rows.min()  # the lamps are below the roof
    assert picture[:10].mean() > 0.5


def test_an_arrow_shows_the_force_of_a_crash_while_it_lasts(seen):
    """60 deg clockwise from the front is to the right of a car that is seen from behind."""
    assert seen.curves["force hide_render 0"].tolist() == [[0.0, 1.0], [201.0, 0.0], [251.0, 1.0]]
    orange = [_orange(seen.picture(frame)) for frame in (SLOW_FRAME, FAST_FRAME)]
    assert orange[0].sum() == 0
    assert orange[1].sum() > 30
    assert np.nonzero(orange[1])[1].mean() > 160


def _orange(picture):
    """Pixels of the colour of the arrow, #D55E00."""
    return np.abs(picture - np.array([0.835, 0.369, 0.0])).max(axis=-1) < 0.08


def test_captions_are_there_for_every_camera_while_they_last(seen):
    """GNSS is silent from 3 s on, the impact comes at 8 s."""
    for camera in ("follow", "top", "driver", "overview"):
        names = [name for name in seen.curves if f"caption {camera}" in name and "hide_render" in name]
        frames = sorted(seen.curves[name][1:, 0].tolist() for name in names)
        assert frames == [[76.0, 251.0], [201.0, 251.0]]


def test_a_picture_shows_white_letters_on_a_dark_plate(seen):
    plate = seen.picture(FAST_FRAME)[134:164, 8:72]
    assert np.median(plate) < 0.45
    assert 40 < (plate.min(axis=-1) > 0.8).sum() < 900


def test_the_solver_lets_the_vehicle_slide_as_far_as_friction_does(program, tmp_path):
    """v^2 / (2 mu g) after the handover, to a tenth: Bullet is made for looks, and claims no more for its contacts."""
    seen = slide(program, tmp_path, 6.0, 0.5, SLOW_FRAME, SOLVED_FRAME)
    before, after = (np.array(seen.facts["moments"][str(frame)]["vehicle"]) for frame in (SLOW_FRAME, SOLVED_FRAME))
    assert np.abs(before[:3, 3] - (10.0, 0.0, 0.0)).max() < 0.04  # a step of the solver
    assert after[0, 3] - 10.0 == pytest.approx(10.0**2 / (2 * 0.5 * 9.81), rel=0.1)
    assert np.abs(after[1:3, 3]).max() < 0.02  # it stays on its way and on the ground


def test_the_solver_moves_the_vehicle_for_half_a_minute_and_nothing_else_is_baked(program, tmp_path):
    """Without friction it slides for 30 s of 50, and then lies: the frames before and after cost a reader nothing."""
    last, end = HANDOVER + 30 * FPS, 50 * FPS
    seen = slide(program, tmp_path, 50.0, 0.0, last, end)
    assert seen.facts["bake"] == [HANDOVER - 3, last]
    then, later = (np.array(seen.facts["moments"][str(frame)]["vehicle"]) for frame in (last, end))
    assert then[0, 3] == pytest.approx(10.0 + 30.0 * 10.0, rel=0.01)
    assert np.array_equal(then, later)


def slide(program, folder, seconds, friction, *frames):
    """Straight on at 10 m/s, and from 1 s on as the solver has it."""
    t_s = np.arange(0.0, seconds + 0.001, 0.01)
    position, velocity = np.outer(t_s, (10.0, 0.0, 0.0)), np.tile((10.0, 0.0, 0.0), (len(t_s), 1))
    blender(
        trajectory=drive(t_s, pos=position, vel=velocity, q=from_euler(np.zeros(len(t_s)), 0.0, 0.0)),
        gnss=None,
        events=happened((0.9, 1.0), kind="crash"),
        streams={},
        folder=folder,
        about=RunInfo("a slide"),
        params=BlenderParams(blender=program, solver=True, slow_motion=1.0, friction=friction, restitution=0.0),
    )
    return look(find_blender(program), folder, *frames)


def make(program, folder, **params):
    """The files of three frames of a straight drive."""
    t_s = np.arange(0.0, 0.081, 0.01)
    trajectory = drive(t_s, pos=np.outer(t_s, (5.0, 0.0, 0.0)), vel=np.tile((5.0, 0.0, 0.0), (len(t_s), 1)))
    folder.mkdir()
    small = {"blender": program, "resolution": (64, 36), "samples": 1, **params}
    about, given = RunInfo("three frames"), BlenderParams(**small)
    return blender(trajectory=trajectory, gnss=None, events=None, streams={}, folder=folder, about=about, params=given)


def test_every_frame_of_the_film_is_rendered_where_that_is_asked_for(program, tmp_path):
    paths = make(program, tmp_path / "film", render="animation")
    assert [path.name for path in paths if path.parent.name == "frames"] == ["0001.png", "0002.png", "0003.png"]
    assert all(path.stat().st_size for path in paths)


def test_the_car_is_that_of_the_user_where_he_has_one(program, tmp_path):
    """Whatever is in his file moves with the vehicle: here the cube of an own .blend."""
    own = tmp_path / "own.blend"
    script = tmp_path / "own.py"
    script.write_text(
        "import bpy\n"
        "bpy.ops.wm.read_factory_settings(use_empty=True)\n"
        "cube = bpy.data.objects.new('my car', bpy.data.meshes.new('my mesh'))\n"
        "bpy.context.scene.collection.objects.link(cube)\n"
        f"bpy.ops.wm.save_as_mainfile(filepath={str(own)!r})\n",
        encoding="utf-8",
    )
    said = run_inside(find_blender(program), script)
    assert own.is_file(), said
    make(program, tmp_path / "scene", vehicle=str(own))
    objects = look(find_blender(program), tmp_path / "scene", 1).facts["objects"]
    assert "my car" in objects
    assert not {"body", "cabin", "wheel front left"} & set(objects)


CLIP = """
import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("light")
scene.world.use_nodes = True
color = next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground").inputs["Color"]
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
scene.view_settings.view_transform = "Standard"
scene.render.resolution_x, scene.render.resolution_y, scene.render.fps = 64, 36, 10
scene.frame_start, scene.frame_end = 1, 20


def paint(scene, *rest):
    color.default_value = (1.0, 0.0, 0.0, 1.0) if scene.frame_current <= 10 else (0.0, 1.0, 0.0, 1.0)


bpy.app.handlers.frame_change_pre.append(paint)
if bpy.app.version >= (5, 0, 0):
    scene.render.image_settings.media_type = "VIDEO"
scene.render.image_settings.file_format = "FFMPEG"
scene.render.ffmpeg.format, scene.render.ffmpeg.codec = "MPEG4", "H264"
scene.render.ffmpeg.gopsize, scene.render.use_file_extension = 1, False
scene.render.filepath = sys.argv[-1]
bpy.ops.render.render(animation=True)
"""
"""A second of red, then one of green, at ten frames a second: Blender makes it itself."""


def test_a_video_is_behind_the_scene_in_step_with_it(program, tmp_path):
    """It begins 3 s after the start of a film that is half as fast there: green from 4 s on, which is frame 126."""
    clip, script = tmp_path / "clip.mp4", tmp_path / "clip.py"
    script.write_text(CLIP, encoding="utf-8")
    said = run_inside(find_blender(program), script, str(clip))
    assert clip.is_file(), said
    t_s = np.arange(0.0, 6.001, 0.01)
    blender(
        trajectory=drive(t_s, pos=np.outer(t_s, (5.0, 0.0, 0.0)), vel=np.tile((5.0, 0.0, 0.0), (len(t_s), 1))),
        gnss=None,
        events=happened((4.0, 4.1), kind="crash"),
        streams={},
        folder=tmp_path,
        about=RunInfo("a video"),
        params=BlenderParams(
            blender=program, video=str(clip), video_start=3.0, slow_motion=2.0, slow_span=1.0, camera="driver"
        ),
    )
    frames = (80, 125, 126, 170)  # at 3.08, 3.98, 4 and 4.88 s
    seen = look(find_blender(program), tmp_path, *frames)
    shown = [seen.picture(frame)[10:60, 100:220].mean(axis=(0, 1)).argmax() for frame in frames]
    assert shown == [0, 0, 1, 1]
