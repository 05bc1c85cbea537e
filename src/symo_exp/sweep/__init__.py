"""From a command to finished runs: compose and check every job, have them done, sum up."""
