"""One script per figure of the paper, sweeps in the layer's thickness, limits.

`GROUPS` has each study once: group -> study -> seconds that it takes with --quick, and in full, roughly, on one core.
"""

GROUPS = {
    "The paper": {
        "fig3_mohr_coulomb": (20, 82),
        "fig4_bar": (9, 18),
        "fig6_stratified": (8, 16),
        "fig8_friction": (9, 9),
        "relaxation": (9, 28),
        "signorini_limit": (8, 900),
    },
    "Laws": {"limits": (5, 10), "layer_friction": (4, 10), "creep_and_relaxation": (60, 80), "snap": (40, 120)},
    "Sweeps in the thickness": {"rates": (600, 1800), "free_ends": (60, 300), "junctions": (60, 300)},
    "Structures": {"bearing": (30, 200), "punch": (40, 40), "strips": (5, 10), "wall": (200, 200)},
    "Estimates and maps": {"may_i_drop": (100, 400), "which_law": (60, 400), "zoom": (30, 200)},
    "Benchmarks": {"performance": (60, 400), "setup_time": (30, 100), "law_speed": (10, 40)},
}
