"""Results on disk: tables, netCDF, and the journal that a broken run goes on from."""
