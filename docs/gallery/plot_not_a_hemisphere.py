"""
A volume that is not white matter
=================================

If the volume does not look like the white matter of a brain, the error has a figure that shows why. Here a T1 image
was passed instead: above the threshold lie grey matter, cerebellum and brain stem, too. The outline is the template.

.. code-block:: console

    $ voxflat flatten t1.nii.gz --hemisphere left --threshold 0.3 -o lh.npz   # fails, and writes lh.npz.failed.png
"""

import voxflat
from voxflat import demo

_, t1, _ = demo.demo_cortex()
try:
    voxflat.hemisphere(t1, "left", threshold=0.3)
except voxflat.HemisphereError as error:
    print(error)
    figure = error.figure()
figure
