"""Wall time of a simulated second at equal accuracy: our engine beside others, in scenes of a bar, ropes and a sheet.

python -m twinbench.benchmark.engines bar|rope|thrown|cable|sheet           one body and sixteen, on two CPU cores: beside MuJoCo
python -m twinbench.benchmark.engines bar|rope|thrown|cable|sheet --cuda    one, sixteen and 256 at once on the GPU: beside Newton

Each engine is compared with its own refined self only, and may use the setting that is fastest among those whose error (root mean square
over points of the body and all frames) is at most a millimetre. A coarse mesh may be right by luck, where two errors cancel: a bar, whose
mesh each engine chooses, is asked twice, the second time that every finer mesh that was tried is right as well. Ropes, cables and sheets
have 40 and 400 nodes in all engines.
"""
