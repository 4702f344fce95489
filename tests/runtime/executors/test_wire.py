"""What passes between engine and worker arrives as it was, to the last bit and in the order it had."""

from __future__ import annotations

import socket
from fractions import Fraction
from threading import Thread

import numpy as np
import pytest

from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Region
from bayesnet_track.runtime.executors.messages import HEAD, EncodedReference, receive, send

VALUES = np.random.default_rng(0).normal(size=(7, 10))


def across(*message):
    ours, theirs = socket.socketpair()
    with ours, theirs:
        sending = Thread(target=send, args=(ours, message))
        sending.start()
        received = receive(theirs)
        sending.join()
    return received


def test_values_arrive_as_they_were():
    message = (
        None, True, -1, 1 << 80, -0.0, float("1e-310"), "ä\udc80", b"\0" * 100, (1, (2.0, ())), [1, "a"],
        {"a": (None,)}, Region(-3, 0, 5, 9), np.float64(0.1), np.int32(7), np.float32(0.5), Fraction(1, 3),
    )  # fmt: skip
    arrived = across(*message)
    assert arrived == message and [type(one) for one in arrived] == [type(one) for one in message]
    assert str(arrived[4]) == "-0.0"


def test_what_cues_are_asked_and_say_arrives_whole():
    hypotheses = Hypotheses(VALUES[:, :4].copy(), {"angle": VALUES[:, 5]})
    measurement = Measurement(("x", "y"), VALUES[0, :2], VALUES[:2, :2], "floor")
    encoded = EncodedReference({"new": (3, VALUES), "known": (4, None), "small": (None, VALUES[0])})
    asked, said, reference = across(hypotheses, measurement, encoded)
    assert asked.boxes.tobytes() == hypotheses.boxes.tobytes() and list(asked.fields) == ["angle"]
    assert asked.fields["angle"].tobytes() == VALUES[:, 5].tobytes()
    assert (said.fields, said.floor) == (("x", "y"), "floor")
    (several,) = across(Measurement(("x",), VALUES[0, :1], VALUES[:1, :1], 0.0, ((0.5, measurement),), 0.9))
    assert (several.confidence, said.confidence, several.seen) == (0.9, None, None)
    assert several.choices[0][0] == 0.5 and several.choices[0][1].mean.tobytes() == VALUES[0, :2].tobytes()
    assert said.mean.tobytes() == VALUES[0, :2].tobytes()
    assert said.covariance.tobytes() == VALUES[:2, :2].tobytes()
    assert {name: number for name, (number, _) in reference.arrays.items()} == {
        "new": 3, "known": 4, "small": None,
    }  # fmt: skip
    assert reference.arrays["new"][1].tobytes() == VALUES.tobytes() and reference.arrays["known"][1] is None
    # It is kept: none of the other bytes of the message are.
    assert all(
        array is None or (array if array.base is None else array.base).nbytes == array.nbytes
        for _, array in reference.arrays.values()
    )


def test_messages_larger_than_the_channel_holds_and_of_many_arrays_arrive():
    large, many = np.arange(1 << 20), tuple(np.full(n % 700, n) for n in range(2000))
    arrived = across(large, many)
    assert arrived[0].tobytes() == large.tobytes()
    assert [one.tolist() for one in arrived[1]] == [one.tolist() for one in many]


def test_a_channel_that_is_closed_amid_a_message_is_told():
    ours, theirs = socket.socketpair()
    with theirs:
        ours.sendall(HEAD.pack(100) + b"begun")
        ours.close()
        with pytest.raises(EOFError):
            receive(theirs)
