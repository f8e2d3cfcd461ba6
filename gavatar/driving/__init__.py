"""A person in pictures as they come drives an avatar: landmarks of one picture after the other become poses."""
