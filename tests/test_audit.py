"""What an audit says: nothing that was not checked passes for good."""

from tests.audit import judged

GOOD = {"name": "a", "version": "1", "vulns": []}
BAD = {"name": "b", "version": "2", "vulns": [{"id": "PYSEC-1"}, {"id": "PYSEC-2"}]}
SKIPPED = {"name": "c", "skip_reason": "not found"}


def test_a_vulnerability_is_named_and_fails():
    said, status = judged([GOOD, BAD, SKIPPED])
    assert status == 1
    assert said.splitlines() == [
        "audit: 1 of 2 pinned packages have known vulnerabilities; 1 could not be checked",
        "b 2: PYSEC-1, PYSEC-2",
    ]


def test_what_was_not_checked_is_not_called_good():
    assert judged([SKIPPED, SKIPPED]) == (
        "audit: skipped: the registry says nothing of vulnerabilities; nothing was checked",
        0,
    )
    assert judged([GOOD, SKIPPED])[0] == "audit: no known vulnerability in 1 pinned packages; 1 could not be checked"
    assert judged([GOOD]) == ("audit: no known vulnerability in 1 pinned packages", 0)
