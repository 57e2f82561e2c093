"""Diagnosis of a model on logs: find the errors of the simulation, their cause, the extended model, the gain.

`pipeline.diagnose` runs through the stages, one line each; a stage is a function from data to data, in a folder that
imports only what stands above it here (tests/identify/diagnosis/test_order.py):

data        logs admitted, chosen and averaged (`prepare`, `denoise`), what they can show (`audit`), what
            is held out (`split`)
hypotheses  the base model and what recalibration frees (`base`); the catalogue's effects as `candidates` on these logs,
            with the search that their specification (model/effects) says, on grids placed by the logs' scales
noise       the torque's coloured noise (`autoregressive`); what no log tells, projected out always (`nuisance`)
fitting     a hypothesis against the data (`problem`, `fit`), one projection per candidate (`score_test`), the noise
            that the whole catalogue leaves (`noise_model`), the error that a user sees (`simulation_error`)
selection   `forward`: causes enter and leave by `step`s; `entry`: the tests; `detection_limits`
residual    what is left: `dependence` on signals (`features`), `changes` in time, whether it decides (`structure`)
rivals      the alternatives that these logs cannot exclude (`groups`), and which of them contradict the tendon
            elongation where both pulleys' angles are logged (`stretched`)
parameters  the `claims`: selection, structure and alternatives, and again without each dropped cause; the numbers
            reported (`refit`, `profile_refinement`), and what they gain on `held_out` data
refusals    logs that cannot tell, which is the verdict `insufficient` and no error
report      `conclude`: the `result` as data; its `words`, `page` and `pictures`, which other processes draw; the next
            `experiment`

To add a stage: a module in the folder of what it needs last, with one public function from what is there to a frozen
record (arrays with shape and unit, nothing drawn but from the generator that it is given); one line in
`pipeline.diagnose`; a field in `report.details.Outcome`, and what `report.conclude` says of it (a new key of
diagnosis.json is added to `result.to_dict`); a test in the folder of the same name under tests/identify/diagnosis, on
logs that the package did not make. Then `tools/run bench/diagnose --quick`: no target may be lost to it.
"""

from tsa_ctrl.identify.diagnosis.pipeline import diagnose
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Verdict

__all__ = ["Cause", "Diagnosis", "Verdict", "diagnose"]
