"""The methods the thesis and its field are compared with, for comparison only: never deployed."""
