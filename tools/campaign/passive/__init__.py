"""Run and evaluate the experiments of the runaway campaign."""
