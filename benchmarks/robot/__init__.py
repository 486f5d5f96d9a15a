"""Campaigns on a whole robot: MuJoCo body, CiA-402 drives, session, recorder, and what kills it.

``docks`` docks and undocks and replays every flight; ``kills`` lets one part die in mid-approach;
``realtime`` holds a rate beside a busy process; ``fuzz`` feeds hostile packets, files and logs.
"""
