"""How good are gain schedules designed from ordinary records?"""
