"""One script per figure of the paper, sweeps in the layer's thickness, limits.

`GROUPS` has each study once: group -> study -> seconds that it takes with --quick, and in full, roughly, on one core.
"""

GROUPS = {
    "The paper": {
        "fig3_mohr_coulomb": (20, 82),
        "fig4_bar": (10, 16),
        "fig6_stratified": (8, 16),
        "fig8_friction": (8, 8),
        "relaxation": (9, 30),
        "signorini_limit": (8, 900),
    },
    "Laws": {"limits": (4, 8), "layer_friction": (3, 8), "creep_and_relaxation": (50, 80), "snap": (40, 120)},
    "Sweeps in the thickness": {"rates": (600, 1800), "free_ends": (27, 200), "junctions": (17, 200)},
    "Structures": {"bearing": (5, 39), "punch": (19, 90), "strips": (5, 10), "wall": (34, 300)},
    "Estimates and maps": {"may_i_drop": (180, 500), "which_law": (75, 400), "zoom": (31, 150)},
    "Benchmarks": {"performance": (60, 400), "setup_time": (30, 100), "law_speed": (10, 40)},
}
