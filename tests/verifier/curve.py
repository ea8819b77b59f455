"""Signatures by the strict rule of ed25519: one text for each key and signature, and nothing of small or mixed order.

`cryptography` takes a key of small order, which signs whatever one likes, a key with a part of small order, and a key
that is written in a second way. What it takes is asked of it last, and only of what is none of these.
"""

from functools import lru_cache

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

P = 2**255 - 19
# Order of the points that keys and signatures are made of.
ORDER = 2**252 + 27742317777372353535851937790883648493
D = -121665 * pow(121666, P - 2, P) % P
ROOT_OF_MINUS_ONE = pow(2, (P - 1) // 4, P)
IDENTITY = (0, 1, 1, 0)


def point_of(data):
    """The point that 32 bytes stand for (RFC 8032, 5.1.3), if this is the one way to write it."""
    number = int.from_bytes(data, "little")
    sign, y = number >> 255, number & (2**255 - 1)
    if len(data) != 32 or y >= P:
        return None
    above, below = (y * y - 1) % P, (D * y * y + 1) % P
    x = above * pow(below, 3, P) * pow(above * pow(below, 7, P), (P - 5) // 8, P) % P
    if (below * x * x + above) % P == 0:
        x = x * ROOT_OF_MINUS_ONE % P
    if (below * x * x - above) % P != 0 or (x == 0 and sign == 1):
        return None
    if x & 1 != sign:
        x = P - x
    return (x, y, 1, x * y % P)


def plus(one, other):
    a = (one[1] - one[0]) * (other[1] - other[0]) % P
    b = (one[1] + one[0]) * (other[1] + other[0]) % P
    c = 2 * D * one[3] * other[3] % P
    d = 2 * one[2] * other[2] % P
    e, f, g, h = b - a, d - c, d + c, b + a
    return (e * f % P, g * h % P, f * g % P, e * h % P)


def times(count, point):
    total = IDENTITY
    while count:
        if count & 1:
            total = plus(total, point)
        point, count = plus(point, point), count >> 1
    return total


def is_identity(point):
    return point[0] % P == 0 and (point[1] - point[2]) % P == 0


def is_small(point):
    """Whether a point is of small order: eight of them are."""
    return is_identity(times(8, point))


@lru_cache(maxsize=4096)
def public_key(data):
    """The key of 32 bytes, which is of the full order and written in the one way."""
    point = point_of(data)
    if point is None or is_small(point) or not is_identity(times(ORDER, point)):
        raise ValueError("it is no public key")
    return Ed25519PublicKey.from_public_bytes(data)


def is_signed(key, signature, message):
    """Whether this key, 32 bytes, made the signature over the message."""
    if len(signature) != 64 or int.from_bytes(signature[32:], "little") >= ORDER:
        return False
    first = point_of(signature[:32])
    if first is None or is_small(first):
        return False
    try:
        public_key(key).verify(signature, message)
    except (InvalidSignature, ValueError):
        return False
    return True
