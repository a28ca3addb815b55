from kvision.filters.sobel import Sobel, sobel
