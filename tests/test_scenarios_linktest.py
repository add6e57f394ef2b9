"""What `ropeteam link test` says of a link is so."""

import importlib
import io
import json
import math
import sys
from dataclasses import replace
from fractions import Fraction
from itertools import accumulate, pairwise
from pathlib import Path
from statistics import median

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from comms.profiles import PROFILES, LinkProfile
from scenarios.commands import link
from scenarios.commands.parsing import OK, Parser
from scenarios.errors import StudyError
from scenarios.linktest import real as linkreal
from scenarios.linktest import transfer as linktest
from scenarios.linktest.figures import Figures, figures
from scenarios.linktest.page import measured_rows, show
from scenarios.linktest.real import on_real_clock
from scenarios.linktest.transfer import LinkTest, LinkTestError
from scenarios.linktest.virtual import on_virtual_clock

SOJOURNER = PROFILES["sojourner"]
ORBITER = PROFILES["orbiter"]
quick = settings(max_examples=40, deadline=None)
profiles = st.builds(
    LinkProfile,
    name=st.just("any"),
    rate_bps=st.sampled_from([2400.0, 9600.0, 1333.3, 128000.0, math.inf]) | st.floats(1, 1e9),
    latency_ns=st.integers(1_000_000, 10**9),
    frame_bytes=st.integers(64, 1024),
    overhead_bytes=st.integers(0, 64),
)


def found(profile: LinkProfile, payload_bytes: int, seed: int = 1) -> Figures:
    return figures(on_virtual_clock(LinkTest(profile, payload_bytes, seed)))


def command(*argv: str) -> int:
    parser = Parser(prog="ropeteam")
    link.add(parser.add_subparsers(dest="command", parser_class=Parser))
    args = parser.parse_args(["link", "test", *argv])
    return args.run(args)


# On the virtual clock


def test_sojourner_takes_as_long_as_reckoned_by_hand() -> None:
    # 244 bytes of payload in a frame of 256: 41 frames. Envelopes of the first 128 frames have 10
    # bytes, the modem adds 6: 10,000 + 410 + 246 bytes, 35.52 s at 2400 bps.
    of = found(SOJOURNER, 10_000)
    assert of.frames == 41
    assert (of.payload_bytes, of.envelope_bytes, of.overhead_bytes) == (10_000, 410, 246)
    assert of.charged_bytes == 10_656
    assert of.expected_s == pytest.approx(35.52, abs=1e-12)
    assert of.measured_s == pytest.approx(35.52, abs=41e-9)
    assert of.measured_bps == pytest.approx(2400, rel=1e-8)
    assert of.first_byte_s == pytest.approx(260 * 8 / 2400 + 0.05, abs=1e-9)
    assert of.last_byte_s == pytest.approx(35.57, abs=41e-9)
    assert of.goodput_bps == pytest.approx(80_000 / 35.57, rel=1e-8)
    assert (of.lost_frames, of.lost_bytes, of.dropped) == (0, 0, {})


@quick
@given(profiles, st.integers(1, 5000), st.integers(0, 9))
def test_all_is_exact_on_the_virtual_clock(
    profile: LinkProfile, payload_bytes: int, seed: int
) -> None:
    test = LinkTest(profile, payload_bytes, seed)
    trial = on_virtual_clock(test)
    assert b"".join(frame.payload for frame in trial.heard) == test.payload()
    assert sum(frame.piece_bytes for frame in trial.sent) == payload_bytes
    for frame in trial.sent:
        took_ns = frame.put_ns - frame.start_ns
        if math.isinf(profile.rate_bps):
            assert took_ns == 0
        else:
            bits_ns = 8 * 10**9 * frame.charged_bytes / Fraction(profile.rate_bps)
            assert 0 <= took_ns - bits_ns < 1
        assert frame.frame_bytes <= profile.frame_bytes
        assert frame.charged_bytes == frame.frame_bytes + profile.overhead_bytes
    for one, next_one in pairwise(trial.sent):
        assert next_one.start_ns == one.put_ns
    for sent, heard in zip(trial.sent, trial.heard, strict=True):
        assert heard.heard_ns == heard.arrive_ns == sent.put_ns + profile.latency_ns

    of = figures(trial)
    assert of.charged_bytes == of.payload_bytes + of.envelope_bytes + of.overhead_bytes
    assert of.end_late.max_s <= 1e-9
    assert 0 <= of.drift_s <= 1e-9 * of.frames + 1e-12


def test_what_is_lost_is_told() -> None:
    of = found(replace(ORBITER, loss=0.3), 200_000)
    assert of.lost_frames == of.dropped["lost"]
    assert 0.2 < of.lost_frames / of.frames < 0.4
    assert 0.2 < of.lost_bytes / 200_000 < 0.4
    assert of.goodput_bps is not None
    assert of.goodput_bps < 0.8 * 128_000


def test_luck_is_the_seeds() -> None:
    test = LinkTest(replace(ORBITER, loss=0.5, jitter_ns=10**8), 20_000)
    assert on_virtual_clock(test) == on_virtual_clock(test)
    assert on_virtual_clock(replace(test, seed=2)).heard != on_virtual_clock(test).heard


def test_a_deaf_link_is_told_without_a_fault() -> None:
    of = found(replace(SOJOURNER, loss=1.0), 500)
    assert (of.first_byte_s, of.last_byte_s, of.goodput_bps, of.handed_late) == (None,) * 4
    assert of.lost_bytes == 500
    rows = {row[0]: row[1:] for row in measured_rows(replace(SOJOURNER, loss=1.0), of)}
    assert rows["lost"] == ("100.0 %", "100.0 %")
    assert rows["last byte"] == ("never", "never")


def test_an_unlimited_link_takes_no_time() -> None:
    of = found(PROFILES["unlimited"], 10_000)
    assert (of.configured_bps, of.measured_bps) == (None, None)
    assert (of.expected_s, of.measured_s, of.last_byte_s) == (0, 0, 0.02)


def test_a_fault_of_ours_is_no_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(linktest.Listener, "on_frame", broken)
    with pytest.raises(ZeroDivisionError, match="ours"):
        on_virtual_clock(LinkTest(SOJOURNER, 100))


def test_a_byte_that_changed_on_its_way_is_noticed() -> None:
    trial = on_virtual_clock(LinkTest(SOJOURNER, 1000))
    frame = trial.heard[2]
    wrong = replace(frame, payload=frame.payload[:-1] + bytes([frame.payload[-1] ^ 1]))
    with pytest.raises(AssertionError):
        figures(replace(trial, heard=[*trial.heard[:2], wrong, *trial.heard[3:]]))


# On the wall clock


def test_two_processes_keep_the_links_times_on_the_wall_clock() -> None:
    test = LinkTest(ORBITER, 6000)
    trial = on_real_clock(test)
    assert b"".join(frame.payload for frame in trial.heard) == test.payload()
    for sent, heard in zip(trial.sent, trial.heard, strict=True):
        assert sent.put_ns >= sent.start_ns + 8 * 10**9 * sent.charged_bytes / ORBITER.rate_bps
        assert heard.arrive_ns <= heard.heard_ns
    of = figures(trial)
    assert of.measured_s >= of.expected_s > 0.3
    assert of.end_late.median_s < 0.010
    assert of.first_byte_s is not None
    assert of.first_byte_s == pytest.approx(of.first_byte_expected_s, abs=0.05)
    assert (of.lost_frames, of.cut_frames) == (0, 0)


def test_lateness_does_not_add_up_on_the_wall_clock() -> None:
    trial = on_real_clock(LinkTest(replace(ORBITER, frame_bytes=64), 5200))
    assert len(trial.sent) == 100
    bits_ns = accumulate(8 * 10**9 * frame.charged_bytes / 128_000 for frame in trial.sent)
    begun_ns = trial.sent[0].start_ns
    behind_ns = [f.put_ns - begun_ns - due for f, due in zip(trial.sent, bits_ns, strict=True)]
    # A millisecond late a frame would make 50 at the middle one.
    assert median(behind_ns) < 15e6


def test_a_receiver_that_dies_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linkreal, "listen_main", print)
    with pytest.raises(LinkTestError, match="receiving process"):
        on_real_clock(LinkTest(ORBITER, 100))


# The command


def test_the_page_fits_a_terminal_and_has_both_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--profile", "sojourner", "--bytes", "10000") == OK
    page = capsys.readouterr().out
    words = [line.split() for line in page.splitlines()]
    assert ["rate", "2,400", "bps", "2,400.000", "bps"] in words
    assert ["all", "sent", "35.520", "s", "35.520", "s"] in words
    assert "payload 93.8 %, envelope 3.8 %, overhead 2.3 %" in page
    assert max(map(len, page.splitlines())) <= 80
    assert len(words) < 20


def test_the_page_names_what_was_dropped() -> None:
    test = LinkTest(replace(ORBITER, loss=0.5, jitter_ns=10**8), 20_000)
    page = io.StringIO()
    show(test, "virtual", figures(on_virtual_clock(test)), "so", Console(file=page, width=99))
    assert "latency 50 ms to 150 ms" in page.getvalue()
    assert "\nso\n" in page.getvalue()
    assert "payload did not come" in page.getvalue()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("duplication=1.0", "replayed 41; 0 bytes of payload did not come"),
        ("bit_errors=0.5", "10,000 bytes of payload did not come"),
        ("outages_s=[[0, 100]]", "outage 41; 10,000 bytes"),
        ("channel=tdma", "s in all for the channel, which two share"),
        ("channel=csma", "s in all for the channel, which two share"),
        ("reordering=1.0", "goodput"),
    ],
)
def test_every_fault_can_be_tried(
    setting: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("--profile", "sojourner", "--set", setting) == OK
    page = capsys.readouterr().out
    assert f"with {setting}" in page
    assert words in page
    assert "late by" not in page.split("drift")[0].split("waited")[0]


def test_the_figures_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("--profile", "mer-low", "--rate-bps", "6000", "--json", "--bytes", "100") == OK
    told = json.loads(capsys.readouterr().out)
    assert (told["profile"], told["clock"], told["configured_bps"]) == ("mer-low", "virtual", 6000)
    assert told["charged_bytes"] == 122
    assert told["end_late"]["max_s"] <= 1e-9


def test_options_and_settings_lay_over_the_profile(capsys: pytest.CaptureFixture[str]) -> None:
    sets = ("--set", "latency_s=0.5", "--set", "frame_bytes=100", "--set", "rate_bps=4800")
    assert command("--profile", "sojourner", "--rate-bps", "9600", *sets) == OK
    page = capsys.readouterr().out
    assert "4,800 bps, latency 500 ms, frames of at most 100 bytes + 6 overhead" in page


@pytest.mark.parametrize(
    ("argv", "sentence"),
    [
        ("--profile sojorner", '--profile sojorner: profile = "sojorner": must be one of sojour'),
        ("--loss 1.5", "--loss 1.5: loss = 1.5: must be a number of at least 0 and at most 1"),
        ("--rate-bps -1", "--rate-bps -1.0: rate_bps = -1.0: must be"),
        ("--rate-bps 0", r"carries nothing \(rate 0 bps"),
        ("--set up=false", "the link carries nothing"),
        ("--set lost=1", "--set lost=1: lost = 1: there is no such key, did you mean loss"),
        ("--set links.loss=1", r"must be a key of \[links\]"),
        ("--set loss", "--set loss: must be KEY=VALUE"),
        ("--bytes 0", "--bytes is 0; 1 to 10000000 are allowed"),
        ("--bytes 10000001", "--bytes is 10000001"),
        ("--bytes 10000000 --rate-bps 1", "would take .* days at 1 bps; at most 30"),
        ("--set trace_file=nowhere.csv", "nowhere.csv: can't be read"),
        ("--seed -1", "--seed is -1; 0 to"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(argv: str, sentence: str) -> None:
    with pytest.raises(StudyError, match=sentence):
        command(*argv.split())


# The benchmarks


@pytest.fixture
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = str(Path(__file__).parents[1] / "benchmarks")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(sys, "modules", dict(sys.modules))


def enter_or_skip() -> list[str]:
    enter = importlib.import_module("namespaces").how_to_enter()
    if isinstance(enter, str):
        pytest.skip(enter)
    return enter


@pytest.mark.usefixtures("benchmarks")
def test_a_shaper_with_credit_is_too_fast() -> None:
    rates = importlib.import_module("link_rates")
    enter = enter_or_skip()
    if isinstance(rates.how_to_shape(), str):
        pytest.skip(rates.how_to_shape())
    case = rates.Case(128_000, 200, 20)  # 242 bytes each: 19 of them take 0.287 s
    assert case.exact_s == pytest.approx(0.28738, abs=1e-5)
    with_credit_s, without_s = rates.through_tbf([case], enter)
    # It saves up 1516 bytes: six packets leave at once.
    assert with_credit_s < 0.85 * case.exact_s
    assert without_s > 0.95 * case.exact_s


@pytest.mark.usefixtures("benchmarks")
def test_below_a_frame_zenoh_and_tcp_add_bytes() -> None:
    overhead = importlib.import_module("zenoh_overhead")
    found = overhead.measure(5, enter_or_skip())
    assert found["idle"] == 0
    for row in found["rows"]:
        assert row["frame"] < row["packet"] < row["stream"] < row["in_packets"]
        assert row["stream"] - row["packet"] < 64


@pytest.mark.usefixtures("benchmarks")
def test_without_namespaces_a_benchmark_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert "no unshare" in importlib.import_module("namespaces").how_to_enter()
