"""Lenses: how a camera's glass distorts points on the plane z = 1, and how that is undone.

INPUTS: components of points on the plane z = 1 in front of the camera, a lens's coefficients.
OUTPUTS: components of the distorted points, and back; NumPy in, NumPy out, and so with JAX.

A lens is a class with the methods of these two, and its entry in ``LENSES``. Calibration files
name it in ``formats/cameras/calibration.py``.
"""

from jaxmocap.compilation.arrays import Numbers, namespace

# A component of points, or a lens's coefficients.
Component = Numbers
# Names in ``LENSES``.
BROWN_CONRADY = "brown_conrady"
FISHEYE = "fisheye"
# Points nearer to the optical axis than this (on the plane z = 1) are taken as lying on it.
_ON_AXIS = 1e-6
# Radians from the optical axis: a plane z = 1 holds what is less than π / 2 away from it.
WIDEST_RAD = 1.55
# Newton's method divides by no smaller slope: a lens that is this flat shows nothing any more.
_LEAST_SLOPE = 0.05
_NEWTON_STEPS = 8
# No step goes farther on the plane z = 1: beyond where a lens folds the derivatives mislead.
_LONGEST_STEP = 0.5


class BrownConrady:
    """OpenCV's rational radial and tangential distortion: ordinary lenses."""

    coefficients: tuple[str, ...] = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")

    def distort(self, k: Component, x: Component, y: Component) -> tuple[Component, Component]:
        """Distorted components (...) of points (...) on the plane z = 1."""
        k1, k2, p1, p2, k3, k4, k5, k6 = k
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return x * radial + dx, y * radial + dy

    def undistort(self, k: Component, x: Component, y: Component) -> tuple[Component, Component]:
        """Components (...) on the plane z = 1 of distorted points (...).

        By a fixed number of bounded Newton steps.
        """
        xp = namespace(x)
        plane_x, plane_y = x, y
        for _ in range(_NEWTON_STEPS):
            off_x, off_y = self.distort(k, plane_x, plane_y)
            off_x, off_y = off_x - x, off_y - y
            xx, xy, yy = self.slopes(k, plane_x, plane_y)
            determinant = xp.maximum(xx * yy - xy * xy, _LEAST_SLOPE)
            step_x = (yy * off_x - xy * off_y) / determinant
            step_y = (xx * off_y - xy * off_x) / determinant
            plane_x = plane_x - xp.clip(step_x, -_LONGEST_STEP, _LONGEST_STEP)
            plane_y = plane_y - xp.clip(step_y, -_LONGEST_STEP, _LONGEST_STEP)
        return plane_x, plane_y

    def slopes(
        self, k: Component, x: Component, y: Component
    ) -> tuple[Component, Component, Component]:
        """∂x'/∂x, ∂x'/∂y = ∂y'/∂x and ∂y'/∂y of the distortion at points (...) of z = 1."""
        k1, k2, p1, p2, k3, k4, k5, k6 = k
        r2 = x * x + y * y
        above, below = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = above / below
        # By r², twice.
        bent = k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))
        bent = 2 * bent / below
        return (
            radial + bent * x * x + 2 * p1 * y + 6 * p2 * x,
            bent * x * y + 2 * p1 * x + 2 * p2 * y,
            radial + bent * y * y + 6 * p1 * y + 2 * p2 * x,
        )


class KannalaBrandt:
    """OpenCV's fisheye: the distance from the centre is a polynomial of the angle from the axis.

    Kannala & Brandt, "A generic camera model and calibration method for conventional, wide-angle,
    and fish-eye lenses", PAMI 2006: θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸). What lies 90° or
    more away from the axis has no place on the plane z = 1 and is not described.
    """

    coefficients: tuple[str, ...] = ("k1", "k2", "k3", "k4")

    def distort(self, k: Component, x: Component, y: Component) -> tuple[Component, Component]:
        """See ``BrownConrady.distort``."""
        _, _, scale = self._polar(k, x, y)
        return x * scale, y * scale

    def undistort(self, k: Component, x: Component, y: Component) -> tuple[Component, Component]:
        """See ``BrownConrady.undistort``; by a fixed number of Newton steps for the angle."""
        xp = namespace(x)
        radius, on_axis = _radius(x, y)
        angle = xp.minimum(radius, WIDEST_RAD)
        for _ in range(_NEWTON_STEPS):
            off = angle * _polynomial(k, angle, (1, 1, 1, 1)) - radius
            slope = xp.maximum(_polynomial(k, angle, (3, 5, 7, 9)), _LEAST_SLOPE)
            angle = xp.clip(angle - off / slope, 0.0, WIDEST_RAD)
        scale = xp.where(on_axis, 1.0, xp.tan(angle) / radius)
        return x * scale, y * scale

    def slopes(
        self, k: Component, x: Component, y: Component
    ) -> tuple[Component, Component, Component]:
        """See ``BrownConrady.slopes``."""
        radius, angle, scale = self._polar(k, x, y)
        along = _polynomial(k, angle, (3, 5, 7, 9)) / (1 + x * x + y * y)
        stretch = (along - scale) / radius**2
        return scale + stretch * x * x, stretch * x * y, scale + stretch * y * y

    def _polar(
        self, k: Component, x: Component, y: Component
    ) -> tuple[Component, Component, Component]:
        """Distances from the axis, angles from it, and by how much the distances are scaled."""
        xp = namespace(x)
        radius, on_axis = _radius(x, y)
        angle = xp.arctan(radius)
        return (
            radius,
            angle,
            xp.where(on_axis, 1.0, angle * _polynomial(k, angle, (1, 1, 1, 1)) / radius),
        )


def _radius(x: Component, y: Component) -> tuple[Component, Component]:
    """Distances from the axis, 1 where that is 0 to all purposes, and where it is."""
    xp = namespace(x)
    squared = x * x + y * y
    on_axis = squared < _ON_AXIS**2
    return xp.sqrt(xp.where(on_axis, 1.0, squared)), on_axis


def _polynomial(k: Component, angle: Component, factors: tuple[int, int, int, int]) -> Component:
    """1 + Σ f_i k_i θ^(2i): with factors 3 5 7 9 the derivative of θ times that with 1 1 1 1."""
    squared, total = angle * angle, 0.0
    for coefficient, factor in zip((k[3], k[2], k[1], k[0]), factors[::-1], strict=True):
        total = squared * (factor * coefficient + total)
    return 1 + total


LENSES: dict[str, BrownConrady | KannalaBrandt] = {
    BROWN_CONRADY: BrownConrady(),
    FISHEYE: KannalaBrandt(),
}
