"""The control page: shows a society and handles an operator's requests (docs/operate.md).

Sans-IO: `model` has one robot's state and pending requests, `requests` the requests of browsers,
`guard` the access checks. `session` connects the models with the meshes, `server` the session with
the browsers. `web` has the page's files.
"""
