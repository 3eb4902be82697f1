"""Many robots side by side: who differs from its sisters, and what changed since an earlier time."""
