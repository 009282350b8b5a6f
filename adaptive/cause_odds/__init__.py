"""The odds of every cause behind a loop's records, and what follows from them: verdict, settings, the next test."""
