import csv
import math
import random
from pathlib import Path

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.records.tables import (
    EventRow,
    LookRow,
    MapRow,
    Records,
    Row,
    RxRow,
    TxRow,
    from_wire,
    to_wire,
    write_table,
)

TEAM = ("b", "a", "c")
name = st.sampled_from(TEAM)
time_s = st.floats(0, 1e6)
count = st.integers(0, 10**9)
share = st.floats(0, 1)
rows = st.one_of(
    st.builds(LookRow, name, *[time_s] * 6, st.floats(0, 1e6), count, count, time_s, share),
    st.builds(TxRow, name, count, st.sampled_from(["map", "tether"]), count, *[time_s] * 3),
    st.builds(RxRow, name, name, count, time_s, st.sampled_from(["delivered", "lost"])),
    st.builds(
        MapRow, time_s, name, count, count, time_s, st.none() | time_s, count, time_s, time_s
    ),
    st.builds(EventRow, time_s, name, st.text(max_size=5), st.text(max_size=5)),
)


def tx(sender: str, seq: int, start_s: float, end_s: float, size: int = 100) -> TxRow:
    return TxRow(sender, seq, "map", size, start_s, start_s, end_s)


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@settings(max_examples=100, deadline=None)
@given(rows)
def test_a_row_survives_the_wire(row: Row) -> None:
    assert from_wire(to_wire(row)) == row
    assert from_wire(msgpack.unpackb(msgpack.packb(to_wire(row)))) == row


def test_a_wire_of_no_table_is_a_fault() -> None:
    with pytest.raises(KeyError):
        from_wire(("nothing", 1))
    with pytest.raises(TypeError):
        from_wire(("rx", 1))


@settings(max_examples=25, deadline=None)
@given(made=st.lists(rows, max_size=30), seed=st.integers(0, 99))
def test_files_do_not_depend_on_which_robot_spoke_first(
    made: list[Row], seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    def who(row: Row) -> str:
        match row:
            case TxRow():
                return row.sender
            case RxRow():
                return row.receiver
            case _:
                return row.robot

    folders = [tmp_path_factory.mktemp("run") for _ in range(2)]
    queues = {one: [row for row in made if who(row) == one] for one in TEAM}
    first, second = Records(TEAM), Records(TEAM)
    for one in TEAM:
        for row in queues[one]:
            first.add(row)
    rng = random.Random(seed)
    while any(queues.values()):
        second.add(queues[rng.choice([one for one in TEAM if queues[one]])].pop(0))
    first.write(folders[0])
    second.write(folders[1])
    for file in ("looks.csv", "frames.csv", "maps.csv", "events.csv"):
        assert (folders[0] / file).read_bytes() == (folders[1] / file).read_bytes()
    assert sorted(p.name for p in folders[0].iterdir()) == [
        "events.csv",
        "frames.csv",
        "looks.csv",
        "maps.csv",
    ]


def test_the_columns_are_those_that_studies_read(tmp_path: Path) -> None:
    Records(TEAM).write(tmp_path)
    heads = {path.name: path.read_text().strip() for path in tmp_path.iterdir()}
    assert heads["frames.csv"] == "from,to,kind,bytes,chosen_s,start_s,end_s,arrive_s,verdict"
    assert heads["looks.csv"] == (
        "robot,t_s,x_m,y_m,z_m,pan_rad,tilt_rad,expected_cells,obtained_cells,new_cells,"
        "distance_m,coverage"
    )
    assert heads["maps.csv"] == (
        "t_s,robot,own_cells,team_cells,information_bits,elevation_rmse_m,"
        "map_cells,own_bits,heard_bits"
    )


def test_every_frame_has_a_row_per_team_mate_heard_or_not(tmp_path: Path) -> None:
    records = Records(TEAM)
    records.add(tx("b", 0, 1.0, 1.5))
    records.add(tx("a", 0, 1.0, 2.0))
    records.add(tx("b", 1, 1.5, 3.0))
    records.add(RxRow("a", "b", 0, 1.6, "delivered"))
    records.add(RxRow("c", "b", 0, 1.6, "lost"))
    records.add(RxRow("b", "a", 0, 2.1, "damaged"))
    records.add_cut("b", 1, 2.5)
    records.add_downtime("c", 1.9)
    records.write(tmp_path)
    found = [
        (row["from"], row["to"], row["start_s"], row["arrive_s"], row["verdict"])
        for row in read(tmp_path / "frames.csv")
    ]
    assert found == [
        ("a", "b", "1.0", "2.1", "damaged"),
        ("a", "c", "1.0", "", "receiver down"),
        ("b", "a", "1.0", "1.6", "delivered"),
        ("b", "c", "1.0", "", "lost"),
        ("b", "a", "1.5", "", "sender died"),
        ("b", "c", "1.5", "", "sender died"),
    ]


def test_silence_of_a_robot_that_runs_means_that_the_frame_was_under_way() -> None:
    records = Records(["a", "b"])
    records.add(tx("a", 0, 10.0, 11.0))
    assert records.frame_rows()[0][-1] == "not yet arrived"
    records.add_downtime("b", 0.0, 10.5)
    assert records.frame_rows()[0][-1] == "not yet arrived"
    records.add_downtime("b", 11.2, 13.0)
    assert records.frame_rows()[0][-1] == "receiver down"


def test_frames_are_sorted_by_start_sender_sequence_and_receiver() -> None:
    records = Records(TEAM)
    frames = [tx(who, seq, 5.0, 5.0) for who in "ba" for seq in (10, 2, 9)]
    for frame in frames:
        records.add(frame)
    order = [(row.sender, row.seq) for row in records.frames]
    assert order == [("a", 2), ("a", 9), ("a", 10), ("b", 2), ("b", 9), ("b", 10)]
    assert [row[1] for row in records.frame_rows()[:2]] == ["b", "c"]


def test_floats_are_written_in_full_and_what_is_none_is_empty(tmp_path: Path) -> None:
    values = (0.1 + 0.2, 1e-17, 123456789.123456789, math.nan, None, 3)
    write_table(tmp_path / "t.csv", "abcdef", [values])
    (row,) = read(tmp_path / "t.csv")
    assert [float(row[key]) for key in "abc"] == list(values[:3])
    assert (row["d"], row["e"], row["f"]) == ("", "", "3")


def test_the_first_report_on_a_frame_counts() -> None:
    records = Records(["a", "b"])
    records.add(tx("a", 0, 1.0, 2.0))
    for arrive_s, verdict in ((2.5, "delivered"), (2.6, "replayed")):
        records.add(RxRow("b", "a", 0, arrive_s, verdict))
    assert [(rx.arrive_s, rx.verdict) for _, rx in records.deliveries()] == [(2.5, "delivered")]


def test_busy_time_ends_with_the_run_and_with_a_cut() -> None:
    records = Records(["a", "b"])
    records.add(tx("a", 0, 0.0, 2.0))
    records.add(tx("a", 1, 4.0, 6.0))
    records.add(tx("b", 0, 0.0, 100.0))
    assert records.busy_s("a", 10.0) == 4.0
    assert records.busy_s("a", 5.0) == 3.0
    assert records.busy_s("a", 3.0) == 2.0
    records.add_cut("a", 1, 4.5)
    assert records.busy_s("a", 10.0) == 2.5
