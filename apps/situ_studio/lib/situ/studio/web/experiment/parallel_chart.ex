defmodule Situ.Studio.Web.Experiment.ParallelChart do
  @moduledoc false
  # Draws the sets of a run in parallel coordinates: an axis for each parameter and metric, and a line for each set. The
  # page's script reports the parts of axes that the user marks (`experiment.js`), and the table shows only the sets
  # whose lines pass through all of them.
  use Situ.Live.Component
  alias Situ.Studio.Experiments.Axis

  @height 220
  @top 34
  @bottom 24
  @step 150
  @edge 70
  @most 1_000

  attr(:axes, :list, required: true)
  attr(:rows, :list, required: true)
  attr(:all, :list, required: true)
  attr(:ranges, :map, required: true)
  attr(:selected, :any, required: true)
  attr(:baseline, :any, required: true)

  @doc false
  def parallel_chart(assigns) do
    axes = Enum.with_index(assigns.axes)
    shown = MapSet.new(assigns.rows, & &1.number)
    numbers = {assigns.selected.number, assigns.baseline && assigns.baseline.number}

    lines =
      for row <- Enum.take(assigns.all, @most),
          do:
            {row, line_points(axes, row),
             line_class(row, MapSet.member?(shown, row.number), numbers)}

    assigns =
      assign(assigns,
        placed: axes,
        # The important lines are drawn last, above the others.
        lines: Enum.sort_by(lines, fn {row, _, class} -> {line_rank(class), row.number} end),
        height: @height,
        top: @top,
        bottom: @height - @bottom,
        width: 2 * @edge + @step * max(length(axes) - 1, 0)
      )

    ~H"""
    <section class="chart" aria-label="Parallel coordinates">
      <div class="chart-scroll">
        <svg id="parallel" phx-hook="Brush" width={@width} height={@height} role="img"
            data-top={@top} data-bottom={@bottom}
            aria-label={"A line for each of #{length(@all)} sets over #{length(@axes)} axes"}>
          <polyline :for={{row, points, class} <- @lines} :key={row.number} class={class} points={points} />
          <g :for={{axis, i} <- @placed} :key={axis.id} class="axis" data-axis={axis.id} data-x={axis_x(i)}>
            <line x1={axis_x(i)} x2={axis_x(i)} y1={@top} y2={@bottom} />
            <text x={axis_x(i)} y="16" text-anchor="middle" class="name">{axis.label}</text>
            <text :for={{at, text} <- Axis.list_marks(axis)} x={axis_x(i) + 6} y={position_y(at) + 4}>{text}</text>
            <rect :if={@ranges[axis.id]} class="range" x={axis_x(i) - 8} width="16"
                y={position_y(elem(@ranges[axis.id], 1))} height={range_height(@ranges[axis.id])} />
            <rect class="grip" x={axis_x(i) - 16} width="32" y={@top - 8}
                height={@bottom - @top + 16}><title>Drag to mark a range of {axis.label}</title></rect>
          </g>
        </svg>
      </div>
      <p class="hint">Drag along an axis to show only the sets within a range.
        <button :for={{axis, _} <- @placed} :if={@ranges[axis.id]} type="button" class="btn" phx-click="clear"
            phx-value-axis={axis.id}>{axis.label} {range_text(axis, @ranges[axis.id])} ✕</button>
        <button :if={@ranges != %{}} type="button" class="btn" phx-click="clear">Show all sets</button></p>
    </section>
    """
  end

  defp axis_x(index), do: @edge + @step * index

  defp position_y(at),
    do: Float.round(@height - @bottom - at * (@height - @top - @bottom) * 1.0, 1)

  defp range_height({from, to}), do: max(position_y(from) - position_y(to), 3)

  # A set without a value of a metric has a gap there.
  defp line_points(axes, row) do
    for {axis, i} <- axes,
        at = Axis.locate(axis, row),
        into: "",
        do: "#{axis_x(i)},#{position_y(at)} "
  end

  defp line_class(_row, false, _numbers), do: "set out"
  defp line_class(%{number: n}, _shown, {n, _}), do: "set selected"
  defp line_class(%{number: n}, _shown, {_, n}), do: "set baseline"
  defp line_class(_row, _shown, _numbers), do: "set"

  defp line_rank("set out"), do: 0
  defp line_rank("set"), do: 1
  defp line_rank("set baseline"), do: 2
  defp line_rank(_), do: 3

  defp range_text(axis, {from, to}) do
    case for(
           {at, text} <- Axis.list_marks(axis),
           axis.parameter,
           at >= from and at <= to,
           do: text
         ) do
      [] -> format_range(axis, from, to)
      texts -> Enum.join(texts, ", ")
    end
  end

  defp format_range(%{low: nil}, _from, _to), do: ""

  defp format_range(%{low: low, high: high}, from, to) do
    value = &Situ.Experiment.ReportTable.format_value((low + &1 * (high - low)) * 1.0)
    "#{value.(from)} to #{value.(to)}"
  end
end
