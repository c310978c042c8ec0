"""The Real-Time Data Exchange protocol of Universal Robots controllers: what both ends share."""
