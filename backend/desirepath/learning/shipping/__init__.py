"""What lies in a setup's folder, made and stored with its card: policies, query sets. Training itself is `td3`'s."""
