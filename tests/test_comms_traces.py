import csv
import os
from pathlib import Path

import numpy as np
import pytest

from comms.timebase import NS
from comms.traces import MAX_FILE_BYTES, TraceError, read_trace

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
TRACES = SHARED / "data" / "traces"


def written(path, text):
    path.write_text(text)
    return str(path)


def test_rows_hold_until_the_next_and_time_runs_from_the_first(tmp_path):
    path = written(tmp_path / "a.csv", "t_s,up\n100,1\n110,0\n112.5,1\n")
    trace = read_trace(path)
    at = {0: 1, 9.9: 1, 10: 0, 12.4: 0, 12.5: 1, 1e6: 1}
    assert {t: trace.least(round(t * NS), round(t * NS)) for t in at} == at


def test_a_ratio_and_other_columns_in_any_order(tmp_path):
    path = written(tmp_path / "a.csv", "\ufeffwho, delivery_ratio ,t_s\nx,0.25,0\ny,1e-1,1\n")
    trace = read_trace(path)
    assert (trace.least(0, 0), trace.least(0, 2 * NS)) == (0.25, 0.1)


def test_a_looped_trace_begins_anew(tmp_path):
    path = written(tmp_path / "a.csv", "t_s,up\n0,1\n4,0\n6,1\n")
    looped, held = read_trace(path, loop=True), read_trace(path)
    up = [looped.least(t * NS, t * NS) for t in range(20)]
    assert up == [1, 1, 1, 1, 0, 0, 1, 1] * 2 + [1, 1, 1, 1]  # the last row holds for 2 s too
    assert [held.least(t * NS, t * NS) for t in range(6, 20)] == [1] * 14


def test_a_file_that_was_written_anew_is_read_anew(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,up\n0,1\n")
    assert read_trace(str(path)).least(0, 0) == 1
    path.write_text("t_s,up\n0,0\n")
    os.utime(path, ns=(1, 1))
    assert read_trace(str(path)).least(0, 0) == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1: the header is ''; it must name t_s, and either up or delivery_ratio"),
        ("time,up\n0,1\n", "line 1: the header is 'time,up'"),
        ("t_s,prr\n0,1\n", "it must name t_s, and either up or delivery_ratio"),
        ("t_s,up,delivery_ratio\n0,1,1\n", "line 1: the header"),
        ("t_s,up\n", "has no row below its header"),
        ("t_s,up\n0,1\nsoon,1\n", "line 3: t_s = 'soon'; must be a number of seconds"),
        ("t_s,up\n0,1\nnan,1\n", "line 3: t_s = 'nan'"),
        ("t_s,up\n0,0.5\n", "line 2: up = '0.5'; must be 1 or 0"),
        ("t_s,up\n0,yes\n", "line 2: up = 'yes'; must be 1 or 0"),
        ("t_s,delivery_ratio\n0,1.5\n", "line 2: delivery_ratio = '1.5'; must be from 0 to 1"),
        ("t_s,delivery_ratio\n0,nan\n", "line 2: delivery_ratio = 'nan'"),
        ("t_s,up\n1,1\n1,0\n", "line 3: t_s = 1; must be above that of the row before"),
        ("t_s,up\n0,1,2\n", "line 2: 3 values; 2 are allowed"),
    ],
)
def test_what_is_no_trace_is_refused_with_line_value_and_what_is_allowed(tmp_path, text, words):
    path = written(tmp_path / "bad.csv", text)
    with pytest.raises(TraceError) as caught:
        read_trace(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_not_text_or_too_large_is_refused(tmp_path):
    with pytest.raises(TraceError, match="No such file"):
        read_trace(str(tmp_path / "none.csv"))
    with pytest.raises(TraceError, match="can't be read"):
        read_trace(str(tmp_path))
    (tmp_path / "noise").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TraceError, match="no text in UTF-8"):
        read_trace(str(tmp_path / "noise"))
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(TraceError, match="are allowed"):
        read_trace(str(tmp_path / "huge"))


@pytest.mark.skipif(not TRACES.is_dir(), reason=f"no recorded traces in {TRACES}")
def test_recorded_traces_keep_their_delivery_ratio(tmp_path):
    """The columns are renamed as docs/scenarios.md says, and nothing else."""
    with (TRACES / "ieee802154_mac_5s.csv").open(newline="") as file:
        ratios = [float(row["PRR"]) for row in csv.DictReader(file)]
    rows = "\n".join(f"{5 * n},{ratio}" for n, ratio in enumerate(ratios))
    trace = read_trace(written(tmp_path / "mac.csv", f"t_s,delivery_ratio\n{rows}\n"), loop=True)
    told = [trace.least(t, t) for t in range(0, len(ratios) * 5 * NS, 5 * NS)]
    assert told == ratios
    assert np.mean(told) == pytest.approx(0.827, abs=0.001)
    assert trace.least(len(ratios) * 5 * NS, len(ratios) * 5 * NS) == ratios[0]

    with (TRACES / "sigfox_trolley_2016_11.csv").open(newline="") as file:
        packets = [(float(row["tx_unix_s"]), int(row["received"])) for row in csv.DictReader(file)]
    rows = "\n".join(f"{t_s:.3f},{received}" for t_s, received in packets)
    up = read_trace(written(tmp_path / "sigfox.csv", f"t_s,up\n{rows}\n"))
    first_s = packets[0][0]
    heard = [up.least(t, t) for t in (round((t_s - first_s + 1e-4) * NS) for t_s, _ in packets)]
    assert heard == [received for _, received in packets]
    assert np.mean(heard) == pytest.approx(0.846, abs=0.001)
