"""The planner of `navsim plan`: an aerodrome in the browser, with the performance of pseudolite positions."""
