"""Check that a log can be used with a model: columns, units and signs in one call."""

from __future__ import annotations

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.energy import check_energy
from tsa_ctrl.identify.redundancy import check_ends
from tsa_ctrl.identify.units import check_joint, check_ratios
from tsa_ctrl.model.parameters import Model, TendonSheath


def admit(dataset: Dataset, model: Model, *columns: str) -> None:
    """Raise UsageError, with the names of file and column, if `dataset` cannot be used with `model`.

    The log must have the columns that every simulation needs, and those in `columns`. For tendon-sheaths, it is also
    rejected if torques or angles of the two ends disagree by the factor of a unit. It is rejected as well if the sign
    of a channel makes the transmission create energy.
    """
    dataset.require(model, *columns)
    if isinstance(model, TendonSheath):
        recorded = {name: values for name, values in dataset.columns.items() if name not in dataset.derived}
        check_joint(dataset.label or dataset.name, recorded)
        both = {"omega_j", "omega_m"} <= dataset.derived  # derived velocities only repeat their angles, with more noise
        ends = {name: values for name, values in dataset.columns.items() if not (both and name == "omega_m")}
        check_ratios(dataset.label, ends, model.motor_pulley_radius, model.joint_pulley_radius)
        check_ends(dataset.label, ends, dataset.period, model.joint_pulley_radius / model.motor_pulley_radius)
    check_energy(dataset, model)
