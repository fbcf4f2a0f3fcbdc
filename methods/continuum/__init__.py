"""A deformable solid as a continuum in an embedded grid: its body and its hands, told from a recording."""
