"""A subject in one call, a study in one more: files found, flattened, judged, written where a lab's tools look.

`inputs` finds what a hemisphere is made of, `results` says where its results go and whether they are up to date,
`subject` makes them, `study` goes through participants, `group` compares them; `report` and `study_report` show them.
"""
