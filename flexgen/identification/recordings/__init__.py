"""Recordings of real robots: files of experiments, bodies of rigid arms, deflections of gears."""
