"""Diagnosis of a model on logs: find the errors of the simulation, their cause, the extended model, the gain.

`pipeline.diagnose` runs through the stages, one line each; a stage is a function from data to data, in a folder that
imports only what stands above it here (tests/identify/diagnosis/test_order.py):

data        admit, choose and average the logs (`prepare`, `denoise`), check their excitation (`audit`), hold out
            data (`split`)
hypotheses  the base model and what recalibration frees (`base`); the catalogue's effects as `candidates` on these logs,
            with the search that their specification (model/effects) says, on grids placed by the logs' scales
noise       the torque's coloured noise (`autoregressive`); regressors that are always projected out (`nuisance`)
fitting     a hypothesis against the data (`problem`, `fit`), one projection per candidate (`score_test`), the noise
            that the whole catalogue leaves (`noise_model`), the error that a user sees (`simulation_error`)
selection   `forward`: causes enter and leave by `step`s; `entry`: the tests; `detection_limits`
residual    what is left: `dependence` on signals (`features`), `changes` in time, whether it decides (`structure`)
rivals      the alternatives that these logs cannot exclude (`groups`), and which of them contradict the tendon
            elongation where both pulleys' angles are logged (`stretched`)
parameters  the `claims`: selection, structure and alternatives, and again without each dropped cause; the numbers
            reported (`refit`, `profile_refinement`), and the gain on `held_out` data
refusals    logs without enough information: the verdict `insufficient`, which is not an error
report      `conclude`: the `result` as data; its `words`, `page` and `pictures`, which other processes draw; the next
            `experiment`

To add a stage:

1. Add a module to the folder of its last input, with one public function that returns a frozen record. Arrays have a
   shape and a unit, and all random numbers come from the generator that is passed in.
2. Add one line to `pipeline.diagnose`, a field to `report.details.Outcome`, and its use in `report.conclude`. A new key
   of diagnosis.json goes into `result.to_dict`.
3. Add a test to the folder of the same name under tests/identify/diagnosis, on logs that the package did not make.
4. Run `tools/run bench/diagnose --quick`. All targets must still be met.
"""

from tsa_ctrl.identify.diagnosis.pipeline import diagnose
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Verdict

__all__ = ["Cause", "Diagnosis", "Verdict", "diagnose"]
