"""Words as TriCon reads them."""

import pytest
import torch

from angie.generators.tricon.words import (
    NONE,
    HashedWords,
    KnownWords,
    fnv1a,
    parts_of,
    plain,
    words_of_frames,
)
from data_prep.errors import BadInput
from data_prep.speech.words import Word


def test_plain_words():
    assert plain("It's") == "its" and plain("Wait!") == "wait!"
    assert plain("Ärger") == "ärger" and plain("--") == plain("...") == plain("1999") == ""


def test_the_hash_is_that_of_its_authors():
    # from the published test vectors
    assert fnv1a("") == 0x811C9DC5
    assert fnv1a("a") == 0xE40C292C
    assert fnv1a("foobar") == 0xBF9CF968


def test_parts_of_a_word():
    # <big>, and of it <bi big ig> <big big>
    whole = ["<big>", "<bi", "big", "ig>", "<big", "big>"]
    assert parts_of("big", 10**9) == [fnv1a(part) % 10**9 for part in whole]
    assert parts_of("Big", 97) == parts_of("big", 97)


def test_a_vector_is_the_mean_of_its_parts():
    words = HashedWords(50, 3)
    rows = words.rows(["big", "--"])
    assert rows.shape == (3, 64) and (rows[0] == NONE).all()
    made = words(torch.tensor([[0, 1, 0]]), rows)[0]
    mean = words.weight[parts_of("big", 50)].mean(0)
    assert torch.allclose(made[1], mean)
    assert made[[0, 2]].abs().sum() == 0  # frames without a word


def test_a_word_stands_where_it_begins():
    words = [
        Word("so", 0.0, 0.5), Word("it", 0.14, 0.2), Word("is", 0.16, 0.3), Word("--", 0.4, 0.5),
        Word("late", 9.0, 9.5), Word("before", -0.1, 0.1),
    ]  # fmt: skip
    # frames of 1/15 s: 0.14 and 0.16 s are both in frame 2, where the later word stays
    assert words_of_frames(words, [1, 2, 3, 4, 5, 6], 8, 15).tolist() == [1, 0, 3, 0, 0, 0, 0, 0]
    assert words_of_frames([Word("x", 3 / 15, 1)], [1], 5, 15).tolist() == [0, 0, 0, 1, 0]


@pytest.fixture
def vectors(tmp_path):
    path = tmp_path / "some.vec"
    path.write_text("3 2\nbig 1 2\nsmall 3 4\nThe 5 6\n")
    return path


def test_vectors_of_a_file(vectors):
    words = KnownWords.begun(["Small", "the", "unheard", "small"], vectors)
    assert words.weight.tolist() == [[3, 4], [5, 6]]
    rows = words.rows(["the", "unheard"])
    assert rows.tolist() == [[NONE], [1], [NONE]]
    assert words(torch.tensor([[0, 1, 2]]), rows).tolist() == [[[0, 0], [5, 6], [0, 0]]]
    again = KnownWords(2, 2, len(words.letters))
    again.load_state_dict(words.state_dict())
    assert torch.equal(again.rows(["the", "unheard"]), rows)


def test_files_without_vectors(vectors, tmp_path):
    with pytest.raises(BadInput, match="has no vector of a word"):
        KnownWords.begun(["nobody"], vectors)
    with pytest.raises(BadInput, match="missing.vec: not a text file of word vectors"):
        KnownWords.begun(["big"], tmp_path / "missing.vec")
    vectors.write_text("3 2\nbig 1\n")
    with pytest.raises(BadInput, match="big does not have 2 numbers"):
        KnownWords.begun(["big"], vectors)
