"""reader.navego: structures in .mat files become streams along forward, left, up and east, north, up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from array_logs import HEIGHT, LAT, LON, SPEED, navego_gnss, navego_imu, navego_ref, save_mat
from scipy.spatial.transform import Rotation

import recon
import recon_readers.navego
from recon import Streams
from recon.errors import DataError, ReadFailed, UnknownFormat
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import conjugate, multiply, to_euler, to_rotvec
from recon.parameters import NoParams
from recon.tables import matrix, meta, seconds, vector

HEAD = 65_536


def read(path: Path) -> Streams:
    return recon_readers.navego.read(path, NoParams())


def sniffed(path: Path) -> float:
    return recon_readers.navego.sniff(path, b"" if path.is_dir() else path.read_bytes()[:HEAD]).confidence


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_mat(tmp_path / "log" / "imu1.mat", imu1=navego_imu())
    save_mat(tmp_path / "log" / "gnss.mat", gnss=navego_gnss())
    save_mat(tmp_path / "log" / "ref.mat", ref=navego_ref())
    return tmp_path / "log"


def test_vectors_come_along_forward_left_up(folder: Path) -> None:
    imu = read(folder)["imu"]
    assert matrix(imu, "accel")[0].tolist() == [1.0, -0.5, 9.8]
    assert matrix(imu, "gyro")[0].tolist() == [0.1, -0.2, 0.3]
    np.testing.assert_allclose(seconds(imu), np.arange(400) / 100.0, atol=1e-9)  # whole nanoseconds
    assert meta(imu)["clock"] == "relative"


def test_gnss_comes_in_degrees_and_east_north_up_with_its_sigmas(folder: Path) -> None:
    streams = read(folder)
    first = streams["gnss"].to_pylist()[0]
    assert [first["lat"], first["lon"], first["height"]] == pytest.approx([LAT, LON, HEIGHT])
    assert matrix(streams["gnss"], "vel")[0].tolist() == [SPEED, 0.0, 0.0]
    assert matrix(streams["gnss"], "pos_std")[-1].tolist() == [2.0, 1.0, 3.0]
    assert matrix(streams["gnss"], "vel_std")[-1].tolist() == [0.2, 0.1, 0.3]
    arm = [row["value"] for row in streams["metrics"].to_pylist() if row["name"].startswith("lever_arm")]
    assert arm == [1.0, -2.0, 3.0]


def test_a_receiver_without_velocity_is_read(tmp_path: Path) -> None:
    fields = {name: value for name, value in navego_gnss().items() if name not in ("vel", "stdv", "larm")}
    gnss = read(save_mat(tmp_path / "gnss.mat", gnss=fields))["gnss"]
    assert set(gnss.column_names) == {"time", "lat", "lon", "height", "pos_std_e", "pos_std_n", "pos_std_u"}


def test_the_attitude_of_the_reference_is_that_of_the_axes_it_describes(folder: Path) -> None:
    reference = read(folder)["reference"]
    # by definition: turned by yaw, pitch, roll from north, east, down; then both triads renamed
    down_from_body = Rotation.from_euler("ZYX", [60.0, 5.0, 10.0], degrees=True).as_matrix()
    enu_from_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    expected = enu_from_ned @ down_from_body @ np.diag([1.0, -1.0, -1.0])
    found = Rotation.from_quat(np.roll(matrix(reference, "q")[0], -1)).as_matrix()
    np.testing.assert_allclose(found, expected, atol=1e-12)  # rounding of sines and products
    yaw, pitch, roll = to_euler(matrix(reference, "q")[0])
    assert np.degrees([yaw, pitch, roll]) == pytest.approx([30.0, -5.0, 10.0])


def test_the_reference_has_its_place_about_an_anchor(folder: Path) -> None:
    reference = read(folder)["reference"]
    np.testing.assert_allclose(matrix(reference, "pos")[:, 0], SPEED * seconds(reference), atol=1e-6)
    assert matrix(reference, "vel")[0].tolist() == [SPEED, 0.0, 0.0]
    anchor = meta(reference)["anchor"]
    assert [anchor["lat"], anchor["lon"], anchor["height"]] == pytest.approx([LAT, LON, HEIGHT])


def test_a_second_imu_is_kept_beside_the_first(folder: Path) -> None:
    other = navego_imu()
    other["wb"] = other["wb"] + 0.1
    save_mat(folder / "imu2.mat", imu2=other)
    for streams in (read(folder), dict(recon.read(folder)), dict(recon.read(sorted(folder.glob("*.mat"))))):
        assert matrix(streams["imu_2"], "gyro")[0] == pytest.approx(
            matrix(streams["imu"], "gyro")[0] + [0.1, -0.1, -0.1]
        )


@pytest.mark.parametrize("compressed", [True, False])
def test_auto_knows_a_file_of_any_structure_and_a_folder(tmp_path: Path, compressed: bool) -> None:
    structures = {"imu": navego_imu(), "gnss": navego_gnss(), "reference": navego_ref()}
    for stream, fields in structures.items():
        path = save_mat(tmp_path / "log" / f"{stream}.mat", compressed, anything=fields)
        assert sniffed(path) == 0.9
        assert stream in recon.read(path)
    assert set(recon.read(tmp_path / "log")) == {*structures, "metrics"}


def test_a_workspace_of_several_structures_is_read_as_a_folder_of_them(tmp_path: Path) -> None:
    path = save_mat(tmp_path / "all.mat", ref=navego_ref(), imu=navego_imu(), gnss=navego_gnss(), note="of the drive")
    assert set(read(path)) == {"imu", "gnss", "reference", "metrics"}


def test_structures_of_something_else_are_told_and_left_alone(folder: Path) -> None:
    save_mat(folder / "visual.mat", visual={"t": np.arange(3.0), "lat": np.zeros(3)})
    notes = [row["note"] for row in read(folder)["metrics"].to_pylist() if row["name"] == "not_read"]
    assert notes == ["visual.mat: 'visual' is neither imu, gnss nor ref"]


def test_rows_out_of_order_are_left_out_and_told(tmp_path: Path) -> None:
    fields = navego_imu()
    fields["t"][[7, 9, 20], 0] = fields["t"][3, 0], np.nan, fields["t"][19, 0]
    streams = read(save_mat(tmp_path / "imu.mat", imu=fields))
    assert streams["imu"].num_rows == 397
    assert [row["value"] for row in streams["metrics"].to_pylist() if row["name"] == "rows_left_out"] == [3.0]


# --- what is refused ------------------------------------------------------------------------------------------------


def test_a_file_of_matlab_7_3_is_refused_with_the_way_out(tmp_path: Path) -> None:
    path = tmp_path / "imu.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(512))
    with pytest.raises(ReadFailed, match=r"this \.mat file is HDF5") as caught:
        read(path)
    assert caught.value.hint == "save it again in MATLAB with save(name, '-v7')"
    with pytest.raises(UnknownFormat) as unknown:
        recon.read(path)
    assert "save(name, '-v7')" in unknown.value.hint


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"fb": np.zeros((400, 2))}, "imu.fb is of shape (400, 2), where 400 x 3 numbers are needed"),
        ({"fb": np.zeros((3, 400))}, "imu.fb is of shape (3, 400), where 400 x 3 numbers are needed"),
        ({"wb": np.zeros((7, 3))}, "imu.wb is of shape (7, 3), where 400 x 3 numbers are needed"),
        ({"wb": "none"}, "imu.wb holds no numbers"),
        ({"fb": np.full((400, 3), 1e30)}, "accel is 1e+30 in row 0, which no vehicle shows"),
    ],
    ids=["two columns", "turned", "fewer rows", "text", "impossible"],
)
def test_a_wrong_field_is_named_and_refused_in_one_sentence(tmp_path: Path, change: dict, what: str) -> None:
    path = save_mat(tmp_path / "imu.mat", imu={**navego_imu(), **change})
    with pytest.raises(ReadFailed) as caught:
        read(path)
    assert (caught.value.path, caught.value.what) == (path, what)
    assert caught.value.hint


def test_a_latitude_in_degrees_is_refused(tmp_path: Path) -> None:
    fields = navego_gnss()
    fields["lat"] = np.degrees(fields["lat"])
    with pytest.raises(ReadFailed, match=r"lat is 37\.72 in row 0, which no vehicle shows"):
        read(save_mat(tmp_path / "gnss.mat", gnss=fields))


def test_a_damaged_file_is_refused(folder: Path) -> None:
    path = folder / "imu1.mat"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ReadFailed, match=r"imu1\.mat: it is no whole MATLAB file"):
        read(folder)


def test_a_file_or_folder_without_structures_is_refused(tmp_path: Path) -> None:
    path = save_mat(tmp_path / "log" / "other.mat", other={"a": 1.0})
    assert sniffed(path) == 0.3
    assert sniffed(path.parent) == 0.0
    for where in (path, path.parent):
        with pytest.raises(DataError, match="it holds no structure of NaveGo"):
            read(where)
    with pytest.raises(DataError, match=r"it holds no \.mat file"):
        read(tmp_path)


# --- the simulated vehicle of the program itself --------------------------------------------------------------------


@pytest.fixture(scope="module")
def synthetic(logs: Path) -> Streams:
    return read(logs / "navego_synthetic")


def between(table, group: str, t_s: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t_s, seconds(table), column) for column in matrix(table, group).T])


@pytest.mark.parametrize(("stream", "bias"), [("imu", 0.0524), ("imu_2", 0.0035)])
def test_the_gyroscopes_turn_as_the_reference_does(synthetic: Streams, stream: str, bias: float) -> None:
    reference, imu = synthetic["reference"], synthetic[stream]
    q, t_s = matrix(reference, "q"), seconds(reference)
    rate = to_rotvec(multiply(conjugate(q[:-1]), q[1:])) / np.diff(t_s)[:, None]
    measured = between(imu, "gyro", 0.5 * (t_s[1:] + t_s[:-1]))
    for axis in range(3):
        slope, offset = np.polyfit(rate[:, axis], measured[:, axis], 1)
        assert slope == pytest.approx(1.0, abs=0.01)
        # gb_sta of the file, and its gb_dyn and the rate of the Earth, which is not in the rates of the attitude
        assert abs(offset) == pytest.approx(bias, abs=0.006)


@pytest.mark.parametrize(("stream", "bias"), [("imu", 0.4903), ("imu_2", 0.1569)])
def test_the_accelerometers_feel_what_moves_the_reference_and_gravity_upwards(
    synthetic: Streams, stream: str, bias: float
) -> None:
    accel = matrix(synthetic[stream], "accel").mean(axis=0)
    # the vehicle ends nearly where and as it began: gravity, less what leaning takes from it, and ab_sta on z
    assert accel[2] == pytest.approx(9.797 - bias, abs=0.1)


def test_gnss_differs_from_the_reference_by_its_own_sigmas(synthetic: Streams) -> None:
    reference, gnss = synthetic["reference"], synthetic["gnss"]
    t_s = seconds(gnss)
    inside = t_s <= seconds(reference)[-1]
    place = [vector(gnss, name) for name in ("lat", "lon", "height")]
    apart = geodetic_to_enu(*place, Anchor(**meta(reference)["anchor"])) - between(reference, "pos", t_s)
    ratio = (apart / matrix(gnss, "pos_std"))[inside].std(axis=0)
    # 2187 rows: a standard deviation is known to 1 / sqrt(2 n) = 1.5 %; four sigmas
    np.testing.assert_allclose(ratio, 1.0, atol=0.06)
    ratio = ((matrix(gnss, "vel") - between(reference, "vel", t_s)) / matrix(gnss, "vel_std"))[inside].std(axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.06)


def test_the_rover_is_read_with_gravity_upwards(logs: Path) -> None:
    data = logs / "navego_canada" / "data"
    streams = recon.read([data / "imu_planetary.mat", data / "gnss_planetary_r.mat"])
    # 0.4 m/s on rough ground; the mean tilt is 2 deg
    assert matrix(streams["imu"], "accel").mean(axis=0)[2] == pytest.approx(9.8, abs=0.1)
    assert matrix(streams["gnss"], "pos_std")[0].tolist() == [1.0, 1.0, 1.0]
