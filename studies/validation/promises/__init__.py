"""Does every covariance and interval that the library states hold, over plans and grades of noise?"""
