"""The planner of `navsim plan`: an aerodrome in the browser, with what its places of transmitters are worth."""
