"""What several rooms must agree on, stated once."""

import re

import numpy as np

#: Rec. 709 luminance of linear rgb.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: Samples with either direction beyond this angle are left out of fits (Bagher et al. 2016).
MAX_ANGLE = np.deg2rad(89.0)
#: Löw et al. 2012 sum E2 over theta_h and theta_d up to here.
E2_ANGLE = np.deg2rad(80.0)
#: Names that become folders, wildcards and addresses: nothing that a shell, a path or a page could misread.
LONGEST_NAME = 80
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\Z")
#: Names of the two renders of the measured table itself, the second with other random numbers.
REFERENCE, REFERENCE_AGAIN = "reference", "reference_again"
#: Status of a fit's report where an entry of given parameters has none for the material: no row, and no failure.
ABSENT = "absent"
#: Objectives that parametric models offer, as reports name them.
OBJECTIVE_NAMES = {
    "compressive": "compressive (Bagher 2016), relative, rgb averaged",
    "e2": "E2 (Löw 2012)",
    "cosine": "cosine-weighted root mean square (Ngan 2005)",
}
