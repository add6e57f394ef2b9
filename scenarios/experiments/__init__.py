"""The paper's experiments: `ropeteam experiment NAME`. One module each, all in one frame.

To add one, write `scenarios/experiments/NAME.py` (dashes become underscores) that holds

    EXPERIMENT = Experiment(trials=..., measure=..., conclude=..., draw=..., settings={...})

of four plain functions (`scenarios.experiments.frame` has their types), and give it a line in
`EXPERIMENTS` below:

1. `trials(options) -> [trial, ...]` says what is to be measured: plain, picklable values, each with
   its own seed. What the user may set by `--set KEY=VALUE` is named in `settings`.
2. `measure(trial) -> [row, ...]` measures one of them, in a process of its own. It is a function of
   its trial alone: the rows are the same for any `--jobs`.
3. `conclude(rows) -> Findings` turns all rows, in the order of the trials, into tables (`estimate`
   gives means with their 95 % intervals) and claims: for each claim of the paper its words, whether
   it held, and the number that says so.
4. `draw(figure, rows)` draws the paper's figure on an empty matplotlib figure.

The frame does the rest: processes, folder, `rows.csv` (all that was measured), a `.csv` per table,
`experiment.json` (claims and tables), `figure.png`, and what is printed.
"""

EXPERIMENTS = {
    "compress": "what the paper's map codec and its four compressors cost, and what they lose",
    "descents": "whole cliff missions on stereo eyes: endings, and how right the maps are",
    "edge": "the cliff edge as a polygon on ground strewn with rocks",
    "field": "four robots map a cliff of 75 degrees in ten looks, and one goes down it",
    "localisation": "how a camera's error grows with its way, by the fiducials that it goes by",
    "markov": "unknown cells estimated from known ones, and how sure one may be of them",
    "planar-one": "one robot maps a plane: the paper's five ways to choose a look, and ours",
    "planar-two": "two robots map a plane together, by the same ways",
    "sandpit": "where to look next at a pit: the paper's methods 1 to 5, ours, and an oracle",
    "sharing": "what thin links do to a team, by the way of sharing and by rate",
}
"""Name and one line of each, in the order in which they are listed."""
