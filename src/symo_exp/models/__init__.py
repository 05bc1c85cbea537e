"""The four methods as LightningModules; none of them sees the true system."""
