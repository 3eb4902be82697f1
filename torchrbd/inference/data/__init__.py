"""What fits read: columns of x, and second moments per joint and block of time, from recordings and known loads."""
