"""The files of the browser player; `gavatar_runtime.web.page` puts them together."""
