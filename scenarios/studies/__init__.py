"""Studies: a scenario, varied along axes, run side by side, in one table. `ropeteam sweep`, `plot`.

`study` says what is to be run, `trial` runs one, `sweep` keeps the folder and goes on where it was
stopped, `engine` hands trials to Dask, `table` and `figure` show what came out.
"""
