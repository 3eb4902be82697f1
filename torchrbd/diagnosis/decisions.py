"""Every limit that decides what a diagnosis reports, given probabilities, and how sure it says to be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Decisions:
    """Limits; they stand in diagnosis.json.

    Attributes:
        likely: probability above which something is reported as found; below it is one of several candidates.
        largest_probability: no probability is reported above it.
        least_law: probability from which an effect counts as another explanation of a finding.
        no_change: relative change of a held-out error that cannot be distinguished from none.
        least_elpd: standard errors by which a smooth curve must improve the prediction of left-out blocks.
        least_torque, least_error: region of practical equivalence: what carries less than this part of its joint's
            torque while it acts, or removes less than this part of the error of left-out blocks, has no name.
        negligible_torque: a drift below this part of its joint's torque is not reported.
        poor_nmse: a joint with a larger held-out nmse is reported, if its errors have a memory, and depend on the
            states.
        larger_error: held-out errors so many times those on fitted data are unexplained, and drift and noise so many
            times the noise.
        memory: errors that stay alike for so many times as long as white noise does have a memory.
        identified_variance: a parameter has a detection limit if its posterior variance is below this part of its
            prior variance.
        other_variant: a joint origin that is farther off than so many standard deviations of its prior, and of its
            estimate, is another variant's.
        certain_nats: evidence from which an effect is certainly missing, whatever its name.
        doubtful: probability below which a finding is marked as doubtful.
        spring_helps: a spring is confirmed where it leaves less than this part of the deflection's held-out error.
        spring_sure: standard deviations from which a delay or lost motion between two encoders is reported.
        shortest_delay_s: the shortest such delay [s].
        inertial_load: inertial part of a load from which a spring's stiffness is said to depend on the rotor.
    """

    likely: float = 0.5
    largest_probability: float = 0.999
    least_law: float = 0.05
    no_change: float = 0.02
    least_elpd: float = 1.0
    least_torque: float = 0.001
    least_error: float = 0.05
    negligible_torque: float = 0.01
    poor_nmse: float = 0.01
    larger_error: float = 1.5
    memory: float = 2.0
    identified_variance: float = 0.25
    other_variant: float = 3.0
    certain_nats: float = 20.0
    doubtful: float = 0.9
    spring_helps: float = 0.98
    spring_sure: float = 3.0
    shortest_delay_s: float = 1e-4
    inertial_load: float = 0.5


DECISIONS = Decisions()
