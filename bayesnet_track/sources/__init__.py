"""Where frames and detections come from: videos, folders of images, cameras, streams, scenes."""
