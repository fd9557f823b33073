"""What every picture must satisfy: its texts can be read, as plain words and numbers, and lie inside it."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg


def tick_labels(axis):
    """The labels of an `xaxis` or `yaxis` that are in view, without empty ones."""
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    labels = [label for tick in ticks if low - slack <= tick.get_loc() <= high + slack
              for label in (tick.label1, tick.label2) if label.get_visible() and label.get_text()]  # fmt: skip
    return labels if axis.get_visible() and axis.axes.axison else []


def check_texts(figure):
    """Each text of a figure is plain and inside; a logarithmic axis has two labels or more, and none covers another."""
    FigureCanvasAgg(figure).draw()
    texts = [] if figure._suptitle is None else [figure._suptitle]
    legends = list(figure.legends)
    panels = [each for axes in figure.axes for each in (axes, *axes.child_axes)]
    for axes in panels:
        texts += [axes.title, axes._left_title, axes._right_title, *axes.texts]
        texts += [axes.xaxis.label, axes.yaxis.label] if axes.axison else []
        legends += [] if axes.get_legend() is None else [axes.get_legend()]
        for axis in (axes.xaxis, axes.yaxis):
            labels = tick_labels(axis)
            if axis.get_scale() == "log" and labels:
                assert len(labels) >= 2, [label.get_text() for label in labels]
            boxes = [label.get_window_extent() for label in labels]
            for k, box in enumerate(boxes):
                assert not any(box.overlaps(other) for other in boxes[:k]), labels[k].get_text()
            texts += labels
    texts += [text for legend in legends for text in (legend.get_title(), *legend.get_texts())]
    width, height = figure.canvas.get_width_height()
    assert texts
    for text in texts:
        assert "$" not in text.get_text() and "mathdefault" not in text.get_text(), text.get_text()
        if text.get_visible() and text.get_text().strip():
            box = text.get_window_extent()
            inside = box.x0 >= -1 and box.y0 >= -1 and box.x1 <= width + 1 and box.y1 <= height + 1
            assert inside and np.isfinite(box.extents).all(), (text.get_text(), box.extents, (width, height))
