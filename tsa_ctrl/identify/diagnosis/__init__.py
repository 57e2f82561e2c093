"""Diagnose a model on logs: find the errors of the simulation, their causes, an extended model, and its gain.

`pipeline.diagnose` calls the stages, one line each. A stage is a function from data to data. Its folder imports only
the folders above it in this list (tests/identify/diagnosis/test_order.py):

data        admit, choose and average the logs (`prepare`, `denoise`), check their excitation (`audit`), hold out
            data (`split`)
hypotheses  the base model and the parameters that recalibration frees (`base`); the effects of the catalogue as
            `candidates`, searched as their specification (model/effects) defines, on grids scaled to the logs
noise       the torque's coloured noise (`autoregressive`); regressors that are always projected out (`nuisance`)
fitting     the fit of a hypothesis to the data (`problem`, `fit`), one projection per candidate (`score_test`), the
            noise that remains with the whole catalogue (`noise_model`), and the error for a user (`simulation_error`)
selection   `forward`: causes enter and leave one at a time (`step`); `entry`: the tests; `detection_limits`
residual    `dependence` of the residual on signals (`features`), `changes` in time, and their effect on the result
            (`structure`)
rivals      the alternatives that these logs cannot exclude (`groups`), and the alternatives that contradict the tendon
            elongation if the angles of both pulleys are logged (`stretched`)
parameters  the `claims`: selection, structure and alternatives, repeated without each dropped cause; the reported
            parameters (`refit`, `profile_refinement`), and the gain on `held_out` data
refusals    rejection of logs without enough information: the verdict is then `insufficient`, which is not an error
report      the `result` as data (`conclude`); its `words`, `page` and `pictures`, which other processes draw; and the
            next `experiment`

To add a stage:

1. Add a module to the folder of its last input, with one public function that returns a frozen record. State the
   shape and unit of each array. All random numbers come from the generator that is passed in.
2. Add one line to `pipeline.diagnose`, a field to `report.details.Outcome`, and its use in `report.conclude`. A new key
   of diagnosis.json goes into `result.to_dict`.
3. Add a test to the folder of the same name under tests/identify/diagnosis, on logs that were not simulated by the
   package.
4. Run `tools/run bench/diagnose --quick`. All targets must still be met.
"""

from tsa_ctrl.identify.diagnosis.pipeline import diagnose
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Verdict

__all__ = ["Cause", "Diagnosis", "Verdict", "diagnose"]
