"""The commit of the checkout is found, and nothing is written into it."""

import os
import shutil
import subprocess

import pytest

from crosscheck.running import provenance


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_a_checkout_is_only_read(tmp_path):
    """Git would refresh its index: killed by a full disk, it left a lock behind, and no commit was possible."""
    def git(*words):
        subprocess.run(["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True)

    file, index = tmp_path / "file", tmp_path / ".git" / "index"
    file.write_text("content")
    git("init", "-q"), git("add", "file"), git("commit", "-q", "-m", "first")
    os.utime(file, (0, 0))  # the index no longer knows that the file is unchanged
    before = index.read_bytes()
    assert "changes" not in provenance._commit(tmp_path)
    assert index.read_bytes() == before
    file.write_text("other")
    assert provenance._commit(tmp_path).endswith(" + changes")
