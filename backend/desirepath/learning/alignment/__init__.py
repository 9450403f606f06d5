"""From a reward model or posterior to a policy that may be shown."""
