"""The control page: one page that shows a society and takes a person's requests (docs/operate.md).

`model` knows one robot and what was asked of it, `requests` what a browser may say, `guard` who may
say anything: all sans-IO. `session` stands between the models and the meshes, `server` between the
session and the browsers; `web` is the page itself.
"""
