"""One script per figure of the paper, sweeps in the layer's thickness, limits.

`GROUPS` has each study once: group -> study -> seconds that it takes with --quick, and in full, roughly, on one core.
"""

GROUPS = {
    "The paper": {
        "fig3_mohr_coulomb": (13, 74),
        "fig4_bar": (3, 7),
        "fig6_stratified": (5, 9),
        "fig8_friction": (3, 3),
        "relaxation": (7, 34),
        "signorini_limit": (5, 550),
    },
    "Laws": {"limits": (2, 4), "layer_friction": (1, 4), "creep_and_relaxation": (16, 54), "snap": (40, 125)},
    "Sweeps in the thickness": {"rates": (600, 1800), "free_ends": (27, 244), "junctions": (17, 74)},
    "Structures": {"bearing": (5, 39), "punch": (19, 110), "strips": (5, 12), "wall": (34, 430)},
    "Estimates and maps": {"may_i_drop": (180, 410), "which_law": (75, 377), "zoom": (31, 52)},
    "Benchmarks": {"performance": (80, 1500), "law_speed": (10, 40)},
}
