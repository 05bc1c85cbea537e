"""Many runs: jobs composed and checked, launched, watched, summed up."""
