"""What accuracy.py measures, a module for each kind of rows.

| module    | what it does                                                                          |
|-----------|---------------------------------------------------------------------------------------|
| cases     | the simulated drives, what fuser.map is told of them, and what is demanded             |
| scoring   | one drive: simulated, smoothed, held against the truth                                |
| rivals    | the peers on drives of the same kinds, and the wall time of each                       |
| real      | a segment of comma2k19 with most of its GNSS taken away                               |
| tables    | statistics over drives, as Markdown                                                    |
"""
