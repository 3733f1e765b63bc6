"""Maps of fleets: kept by a server that many robots query and several writers change at once."""
