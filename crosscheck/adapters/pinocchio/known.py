"""Known defects of Pinocchio's model and of the integrators of its adapter."""

from crosscheck.adapters.common.known import NAIVE, SINGULAR, SUMMED, naive, summed
from crosscheck.document.known import ORDERS, Known

OPENED = f"{NAIVE}; it shows in every part of a run, and joints of bodies that are turned wrong by as much come apart"
DELASSUS = ("reactions are found from G M^-1 G^T, in which the light body's share hides that of the heavy one: as many "
            "digits are lost as the masses differ by; a second pass with what the first leaves of G a + gamma would "
            "restore them, as it does in lieeuler, whose rows close to 3e-14 m/s^2 here")
DRIFTING = ("joints are held by accelerations alone, and positions drift: at .3 ms they are open by .14 m after 3 s, "
            "where forces have levers of their own; with alpha = beta = 20 /s the run passes")
LOST = dict.fromkeys(ORDERS, 1.0) | {
    "run": 1.0, "position": 850, "attitude": 860, "velocity": 2500, "angular velocity": 5000, "interval attitude": 1.5,
    "interval velocity": 10, "interval angular velocity": 19, "energy": 64, "order intervals": 18,
    "limit position": 2300, "limit attitude": 3500, "limit velocity": 1300, "limit angular velocity": 2200,
    "level position": 25, "level velocity": 7}
"""Where all bars lie on one line, on the parallelogram: of RKMK8 at 10 ms and of SymplecticEuler at .2 ms."""

KNOWN = (
    Known(("4",), ("RK4naive",), summed("surely"), None, SUMMED, NAIVE),
    Known(("4",), ("RK4naive",), summed("maybe"), None, SUMMED, NAIVE, always=False),
    Known(("4",), ("RK4naive",),
          lambda engine, scene, form: naive(engine, scene, form) != "no", None,
          {"level position": 15, "level velocity": 5.4, "order intervals": 1.6}, OPENED, always=False),
    Known(("4",), ("SymplecticEuler", "RK4naive", "RKMK4", "RKMK8"), ("parallelogram", "double_four_bar"),
          None, LOST, SINGULAR, always=False),
    Known(("4",), ("SymplecticEuler", "RK4naive", "RKMK4", "RKMK8"), ("light_heavy",), ("maximal",),
          {"level acceleration": 1.9}, DELASSUS, always=False),
    Known(("4",), ("SymplecticEuler",), ("four_bar",), ("maximal",), {
        "interval velocity": 4, "interval angular velocity": 4, "acceleration": 5, "angular acceleration": 5}, DRIFTING,
          always=False),
)
