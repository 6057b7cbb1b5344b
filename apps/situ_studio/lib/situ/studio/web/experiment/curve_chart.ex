defmodule Situ.Studio.Web.Experiment.CurveChart do
  @moduledoc false
  # Draws a metric over one parameter: the curve of the selected set, with the 95 % intervals of its values, and the
  # curves of all other combinations of parameters.
  use Situ.Live.Component
  alias Situ.Experiment.ReportTable
  alias Situ.Studio.Experiments.{Axis, SetList}

  @width 380
  @height 220
  @left 52
  @right 24
  @top 12
  @bottom 28
  @most 60

  attr(:axis, :any, required: true)
  attr(:over, :list, required: true)
  attr(:rows, :list, required: true)
  attr(:metric, :map, required: true)
  attr(:metrics, :list, required: true)
  attr(:selected, :any, required: true)

  @doc false
  def curve_chart(assigns) do
    %{axis: axis, rows: rows, metric: %{"name" => name}, selected: selected} = assigns
    rows = Enum.filter(rows, & &1.metrics[name].value)
    others = &Map.delete(&1.parameters, axis.parameter)

    {own, rest} =
      rows
      |> SetList.group_curves(axis)
      |> Enum.split_with(&(others.(hd(&1)) == others.(selected)))

    scale = find_scale(List.flatten(own), rows, name)

    assigns =
      assign(assigns,
        own: List.flatten(own),
        rest: Enum.take(rest, @most),
        scale: scale,
        name: name,
        width: @width,
        height: @height,
        left: @left,
        right: @width - @right,
        top: @top,
        bottom: @height - @bottom
      )

    ~H"""
    <section class="chart curves" aria-label="Curves">
      <form id="choose-curve" phx-change="choose">
        <label>Curves of <select class="select" name="metric" aria-label="Metric">
          <option :for={m <- @metrics} value={m["name"]} selected={m["name"] == @name}
            >{m["name"]}.{m["main"]}</option></select></label>
        <label>over <select class="select" name="over" aria-label="Parameter">
          <option :for={o <- @over} value={o.parameter} selected={o.id == @axis.id}>{o.label}</option></select></label>
      </form>
      <p :if={@scale == nil} class="hint">No set has a value of this metric.</p>
      <svg :if={@scale} id="curves" width={@width} height={@height} role="img"
          aria-label={"#{@name} over #{@axis.label}"}>
        <g class="grid">
          <line x1={@left} x2={@right} y1={@bottom} y2={@bottom} />
          <line x1={@left} x2={@left} y1={@top} y2={@bottom} />
        </g>
        <text :for={value <- Enum.uniq(Tuple.to_list(@scale))} x={@left - 6} y={value_y(value, @scale) + 4}
          text-anchor="end">{ReportTable.format_value(value)}</text>
        <text :for={{at, text} <- Axis.list_marks(@axis)} x={place_x(at)} y={@height - 8}
          text-anchor="middle">{text}</text>
        <polyline :for={curve <- @rest} class="curve" points={curve_points(curve, @axis, @name, @scale)} />
        <polyline class="curve own" points={curve_points(@own, @axis, @name, @scale)} />
        <g :for={row <- @own} :key={row.number} class={["point", row.number == @selected.number && "selected"]}>
          <line :if={row.metrics[@name].interval} x1={row_x(row, @axis)} x2={row_x(row, @axis)}
              y1={value_y(elem(row.metrics[@name].interval, 0), @scale)}
              y2={value_y(elem(row.metrics[@name].interval, 1), @scale)} />
          <circle cx={row_x(row, @axis)} cy={value_y(row.metrics[@name].value, @scale)} r="5"
              phx-click="select" phx-value-set={row.number}><title>{point_title(row, @name)}</title></circle>
        </g>
      </svg>
      <p class="hint">The strong curve has the other parameters of set {@selected.number}; bars are 95 % intervals.</p>
    </section>
    """
  end

  # The scale covers all values, and the intervals of the strong curve.
  defp find_scale(own, rows, name) do
    values = for(row <- rows, do: row.metrics[name].value)
    ends = for row <- own, {a, b} <- [row.metrics[name].interval], x <- [a, b], do: x
    if values == [], do: nil, else: Enum.min_max(values ++ ends)
  end

  defp place_x(at), do: Float.round(@left + 12 + at * (@width - @left - @right - 24) * 1.0, 1)
  defp row_x(row, axis), do: place_x(Axis.locate(axis, row))
  defp value_y(_value, {same, same}), do: @height / 2

  defp value_y(value, {low, high}) do
    room = @height - @top - @bottom - 12
    Float.round(@height - @bottom - 6 - (value - low) / (high - low) * room * 1.0, 1)
  end

  defp curve_points(curve, axis, name, scale) do
    Enum.map_join(curve, " ", &"#{row_x(&1, axis)},#{value_y(&1.metrics[name].value, scale)}")
  end

  defp point_title(row, name) do
    %{value: value, interval: interval} = row.metrics[name]
    "Set #{row.number}: #{ReportTable.format_estimate(value, interval)}"
  end
end
