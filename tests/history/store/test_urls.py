"""URLs of stores: no message contains the password, and no file is named after it, whatever is wrong with the URL."""

import pytest

from crosscheck.errors import ArgumentError
from crosscheck.history.runs import open_store

SECRET = "s3cret"
URLS = {
    "postgresql://u@127.0.0.1:1/db?password={}": r"\?password= is not taken",
    "postgresql://u:p@{}@127.0.0.1:1/db": "more than one @",
    "postgresql://u:p@x/{}@127.0.0.1:1/db": "more than one @",
    "postgresql://u:{}@127.0.0.1:port/db": "cannot be read",
    "postgresql://u:{}@127.0.0.1:99999999/db": "99999999 is no port",
    "postgresql://u:{}@127.0.0.1:1/db": "cannot be used",
    "postgres://u:{0}@127.0.0.1:1/db?sslpassword={0}": r"\?sslpassword= is not taken",
    "postgresql://u:{0}@127.0.0.1:1/db?options=-c%20password={0}": r"\?options= is not taken",
    "postgresql://u:{}@[::1/db": "cannot be read",
    "mysql://u:{}@h/db": "mysql is not supported",
    "u:{}@host/db": "URL without its beginning",
    "u:{}/x@host/db": "URL without its beginning",
    "postgresql:u:{}@h/db": "URL without its beginning",
    "//u:{}@h/db": "URL without its beginning",
    "sqlite:///x?password={}": r"\?password= is not taken",
    "sqlite://u:{}@h:5/x": "three strokes",
}


@pytest.mark.parametrize("url", URLS)
def test_a_wrong_url_is_refused_without_its_password(url, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=URLS[url]) as caught:
        open_store(url.format(SECRET))
    said = capfd.readouterr()
    assert SECRET not in f"{caught.value}{caught.value.__cause__}{said.out}{said.err}"
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_path_with_an_at_sign_is_a_path(tmp_path):
    open_store(tmp_path / "me@home.sqlite").dispose()
    assert (tmp_path / "me@home.sqlite").exists()
