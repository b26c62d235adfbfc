"""Learning: a robot with other springs than its model repeats a path and corrects it."""

from exhibit import Page, exhibit

import flexgen

QUESTION = (
    "How fast does a robot learn a path from its own tool error, and where does learning stop?"
)
LITERATURE = """
Iterative learning control: S. Arimoto et al., J. Robotic Systems 1(2), 1984; D. Bristow, M. \
Tharayil, A. Alleyne,
IEEE Control Systems Magazine 26(3), 2006. The low pass Q bounds the frequencies that are \
learned, and with it what
remains: errors above it are not corrected.
"""
PLANTS = {
    "stiffness -20 %": {"stiffness": 0.8},
    "stiffness +20 %": {"stiffness": 1.2},
    "load +3 kg": {"payload": 3.0},
}


def show(page: Page) -> None:
    """Largest tool error over the iterations, of robots that differ from the model."""
    found = {
        name: flexgen.learn("planar5_nmp", plant=plant, iterations=4, progress=False)
        for name, plant in PLANTS.items()
    }
    errors = {name: [1e6 * e for e in learned.errors_m] for name, learned in found.items()}
    n = max(map(len, errors.values()))
    rows = [[name, *e, *("-" for _ in range(n - len(e)))] for name, e in errors.items()]
    page.table(["robot", *(f"{k} repetitions, um" for k in range(n))], rows)

    left, right = page.figure().subplots(1, 2)
    for name, learned in found.items():
        left.semilogy(range(len(errors[name])), errors[name], "o-", label=name)
        right.plot(learned.time, 1e6 * learned.corrections[learned.best][:, 0], lw=1.0)
    left.set_xticks(range(n))
    left.set_xlabel("repetitions")
    left.set_ylabel("largest tool error, µm")
    left.legend()
    right.set_xlabel("time, s")
    right.set_ylabel("learned correction of the path, x, µm")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
