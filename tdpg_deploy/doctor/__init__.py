"""What tdpg-doctor looks at: each device of a cell file, without moving anything."""
