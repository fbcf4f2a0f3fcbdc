"""What every method, metric, layout and term must do: plain functions, which ``twinbench conform`` runs on one and the tests on all."""
