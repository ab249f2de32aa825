"""A public benchmark of flat maps: surfaces, true distances, measures, adapters of other tools, and a page of results.

`manifest` reads `surfaces.json`, which lists the surfaces and where they come from. `fetch` downloads and verifies
them, `shapes` makes those that are defined by a formula, and `prepare` cuts them for the first track. `truth` computes
exact distances, `measures` and `score` evaluate maps, `tools` and `run` make maps with programs that are installed, and
`page` writes the tables and plots. Other tools are imported only when they run.
"""
