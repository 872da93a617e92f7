"""RTMPose-like detectors: ONNX files that give each point's place along x and along y (SimCC).

The only door to onnxruntime.

INPUTS: an ``.onnx`` file; images with the box of the person. OUTPUTS: the model's points.
"""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.keypoint_models import MODELS
from jaxmocap.images.regions import crop_image
from jaxmocap.pipelines.keypoints.detect import Detector

# What these networks are trained with: RGB, 0 to 255.
MEAN = np.array([123.675, 116.28, 103.53], np.float32)
DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)
# A network's type of numbers -> NumPy's.
DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
# Number of points -> model of the first of them: face and hands would be most of a file.
MODEL_OF_COUNT = {17: "COCO_17", 26: "HALPE_26", 133: "COCO_23"}
# With less confidence in every point nobody is there.
LEAST_CONFIDENCE = 0.1


def onnx_detector(path: Path) -> Detector:
    """The detector of a file.

    Raises:
        InputError: onnxruntime is missing, it is no such file, or it is another kind of network.
    """
    session = _session(path)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    shape = inputs[0].shape if len(inputs) == 1 else []
    fixed = [isinstance(n, int) for n in shape]
    is_image = len(shape) == 4 and shape[1] == 3 and all(fixed[2:])
    if not is_image or inputs[0].type not in DTYPES or (fixed[0] and shape[0] != 1):
        expected = "expected one image of 3 channels, a fixed height and width, floats"
        raise InputError(path, f"found inputs {[(i.type, *i.shape) for i in inputs]}, {expected}")
    bins = [output.shape[-1] for output in outputs]
    counts = {output.shape[1] for output in outputs if len(output.shape) == 3}
    if len(outputs) != 2 or len(counts) != 1 or not all(isinstance(n, int) for n in bins):
        found = [tuple(output.shape) for output in outputs]
        expected = "expected two of (batch, points, bins) along x and along y, as RTMPose has"
        raise InputError(path, f"found outputs {found}, {expected}")
    model = MODEL_OF_COUNT.get(counts.pop())
    if model is None:
        expected = f"expected one of {', '.join(map(str, MODEL_OF_COUNT))}"
        raise InputError(path, f"found {outputs[0].shape[1]} points, {expected}")
    size = shape[3], shape[2]
    bins_per_pixel, count = (bins[0] / size[0], bins[1] / size[1]), len(MODELS[model])

    def detect(image: np.ndarray, box: np.ndarray) -> np.ndarray | None:
        """(K, 3) pixels and confidences of the first points; None where nobody is."""
        crop = crop_image(image, box, size)
        pixels = np.moveaxis((crop.image[..., ::-1] - MEAN) / DEVIATION, -1, 0)[None]
        found = session.run(None, {inputs[0].name: pixels.astype(DTYPES[inputs[0].type])})
        along = [np.asarray(part, np.float32)[0, :count] for part in found]
        confidence = np.minimum(*(part.max(-1) for part in along))
        if confidence.max() < LEAST_CONFIDENCE:
            return None
        places = [part.argmax(-1) / n for part, n in zip(along, bins_per_pixel, strict=True)]
        points = crop.pixels_of(np.stack(places, -1))
        return np.column_stack([points, np.clip(confidence, 0, 1)])

    return Detector(model, lambda: nullcontext(detect))


def _session(path: Path) -> Any:
    try:
        import onnxruntime
    except ImportError:
        raise InputError(path, "onnxruntime is missing: pip install 'jaxmocap[onnx]'") from None
    if not path.is_file():
        raise InputError(path, "no such file")
    try:
        return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as error:
        first = str(error).strip().splitlines()[0]
        raise InputError(path, f"cannot be read as ONNX ({first})") from None
