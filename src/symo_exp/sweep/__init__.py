"""Many runs: jobs composed and checked, launched, watched, summarised."""
