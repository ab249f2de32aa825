"""Flatten the hemispheres of a subject or a study, and write maps, measures and reports in the layout of other tools.

`inputs` finds the input files, `results` names the output files, `freshness` checks whether they are up to date,
`subject` makes them, `study` processes participants, `group` compares participants, and `report` and `study_report`
write the HTML pages.
"""
