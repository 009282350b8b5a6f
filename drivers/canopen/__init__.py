"""CANopen nodes that an EDS describes: objects by SDO and PDO, and a virtual node."""
