"""A ChArUco board: what is printed on it, and where its corners are in a picture.

Board frame, which is the stage's where the board lies at the stage's origin: origin in the middle of the printed face,
x to the right and y upwards in the drawing (as `Board.drawing` prints it, read from the front), z out of the face
towards the reader; metres. OpenCV's own frame begins at the drawing's upper left corner and has y down and z into the
face, so it is turned half way about x.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveFloat, model_validator

from acquisition.calibration.files import CalibrationPart
from stage.errors import InputError

Array = NDArray[np.float64]

_SPEC = re.compile(r"(\d+)x(\d+),([\d.]+)mm,([\d.]+)mm,(?:DICT_)?(\w+)")


class Board(CalibrationPart):
    """A printed ChArUco board.

    Attributes
    ----------
    squares : (2,) int
        Columns and rows of squares.
    square_m, marker_m : float
        Edges of a square and of a marker, metres.
    dictionary : str
        Of the markers, as OpenCV names it, without ``DICT_``.
    """

    squares: tuple[int, int]
    square_m: PositiveFloat
    marker_m: PositiveFloat
    dictionary: str = Field(min_length=1)

    @model_validator(mode="after")
    def _printable(self) -> Board:
        if min(self.squares) < 3:
            raise ValueError(f"squares: expected at least 3 x 3, got {self.squares[0]} x {self.squares[1]}")
        if self.marker_m >= self.square_m:
            raise ValueError(f"marker_m: a marker is smaller than a square ({self.square_m} m), got {self.marker_m} m")
        if not hasattr(cv2.aruco, f"DICT_{self.dictionary}"):
            raise ValueError(
                f"dictionary: expected one of OpenCV's, such as 4X4_50 or 5X5_100, got {self.dictionary!r}"
            )
        needed, known = self.squares[0] * self.squares[1] // 2, len(self._words().bytesList)
        if needed > known:
            raise ValueError(f"dictionary: {self.dictionary} has {known} markers, and such a board shows {needed}")
        return self

    @classmethod
    def parse(cls, text: str) -> Board:
        """Read ``COLUMNSxROWS,SQUAREmm,MARKERmm,DICTIONARY``, such as ``7x5,30mm,22mm,4X4_50``; raises `InputError`."""
        match = _SPEC.fullmatch(text.strip())
        try:
            if match is None:
                raise ValueError("expected COLUMNSxROWS,SQUAREmm,MARKERmm,DICTIONARY, such as 7x5,30mm,22mm,4X4_50")
            columns, rows, square, marker, dictionary = match.groups()
            return cls(
                squares=(int(columns), int(rows)),
                square_m=float(square) / 1000,
                marker_m=float(marker) / 1000,
                dictionary=dictionary,
            )
        except ValueError as error:
            errors = getattr(error, "errors", None)
            fault = errors(include_url=False)[0]["msg"].removeprefix("Value error, ") if errors else error
            raise InputError(f"board: {fault}; got {text!r}") from None

    def corner_places(self) -> Array:
        """Inner corners of the squares in the board frame, (n, 3) metres, by corner id."""
        middle = np.array([*np.array(self.squares) * self.square_m / 2, 0.0])
        return np.asarray((np.asarray(self._drawn().getChessboardCorners()) - middle) * (1.0, -1.0, -1.0))

    def drawing(self, px_per_square: int = 100) -> NDArray[np.uint8]:
        """The board to print, without margins: (rows * px_per_square, columns * px_per_square), 0 black, 255 white."""
        size = (self.squares[0] * px_per_square, self.squares[1] * px_per_square)
        return np.asarray(self._drawn().generateImage(size, marginSize=0, borderBits=1), dtype=np.uint8)

    def _drawn(self) -> cv2.aruco.CharucoBoard:
        return cv2.aruco.CharucoBoard(self.squares, self.square_m, self.marker_m, self._words())

    def _words(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))


@dataclass(frozen=True, eq=False)
class SeenCorners:
    """Corners of a board in one picture.

    Attributes
    ----------
    ids : (n,) int
        Which corners.
    pixels : (n, 2) float
        Where.
    """

    ids: NDArray[np.intp]
    pixels: Array

    def __len__(self) -> int:
        """Count of corners."""
        return len(self.ids)


class BoardFinder:
    """Finds one board in pictures."""

    def __init__(self, board: Board) -> None:
        self.board = board

    @cached_property
    def _detector(self) -> cv2.aruco.CharucoDetector:
        markers = cv2.aruco.DetectorParameters()
        markers.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        return cv2.aruco.CharucoDetector(self.board._drawn(), cv2.aruco.CharucoParameters(), markers)

    def find(self, picture: ArrayLike) -> SeenCorners:
        """Corners in a linear picture (height, width, 3), whatever its scale; none where no board is seen."""
        grey = np.asarray(picture, dtype=float).mean(-1)
        white = float(np.percentile(grey, 99.5))
        # Markers are found in 8 bits; the square root spares steps for a board in the shade.
        eight = np.rint(255 * np.sqrt(np.clip(grey / max(white, 1e-12), 0, 1))).astype(np.uint8)
        corners, ids, _, _ = self._detector.detectBoard(eight)
        if ids is None or len(ids) == 0:
            return SeenCorners(np.empty(0, dtype=np.intp), np.empty((0, 2)))
        return SeenCorners(np.asarray(ids, dtype=np.intp).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2))
