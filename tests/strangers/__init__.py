"""Files as strangers have them: each is read rightly, or refused by one line that names the cure.

`FILES` lists them all. `Stranger.write` makes one in a folder; `Stranger.check` looks at the log
that became of it.
"""

from strangers.bag_kinds import BAGS
from strangers.damaged import DAMAGED
from strangers.stranger import Stranger
from strangers.tables import TABLES

FILES: tuple[Stranger, ...] = (*TABLES, *BAGS, *DAMAGED)
