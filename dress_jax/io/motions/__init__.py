"""Files of motions: AMASS, AIST++ and BVH."""
