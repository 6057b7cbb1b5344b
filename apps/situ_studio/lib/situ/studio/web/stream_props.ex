defmodule Situ.Studio.Web.StreamProps do
  @moduledoc false
  # Renders the properties of a stream, or of all streams of a group, in the right sidebar.
  use Situ.Live.Component
  import Situ.Studio.Web.TimeLabels
  alias Situ.Studio.{StreamTotals, Visualizers}

  attr(:figures, :any, required: true)

  @doc "Renders the statistics of one stream, or the totals of several streams."
  def figure_list(assigns) do
    rows =
      for {title, choice} <- [
            {"Messages", :count},
            {"Rate", :rate},
            {"Size", :size},
            {"Latency, mean", :latency},
            {"Duration", :span}
          ],
          text = StreamTotals.format_figure(choice, assigns.figures),
          text != "",
          do: {title, text}

    assigns = assign(assigns, rows: rows)

    ~H"""
    <dl>
      <div :for={{name, value} <- @rows} style="display: contents"><dt>{name}</dt><dd>{value}</dd></div>
      <dt :if={@figures.from}>First</dt><dd :if={@figures.from}><.time_label ns={@figures.from} /></dd>
      <dt :if={@figures.to}>Last</dt><dd :if={@figures.to}><.time_label ns={@figures.to} /></dd>
    </dl>
    """
  end

  attr(:value, :any, required: true)

  @doc "Renders a detail of a stream, either text or a time."
  def detail_value(%{value: {:time, ns}} = assigns) do
    assigns = assign(assigns, ns: ns)
    ~H"<.time_label ns={@ns} />"
  end

  def detail_value(assigns), do: ~H"{@value}"

  attr(:group, :any, required: true)

  @doc "Describes a group of the stream tree."
  def group_properties(assigns) do
    ~H"""
    <h2>{@group.path}</h2>
    <div class="sub">{StreamTotals.format_figure(:streams, StreamTotals.sum_streams(@group.streams))} in total</div>
    <.figure_list figures={StreamTotals.sum_streams(@group.streams)} />
    """
  end

  attr(:stream, :any, required: true)
  attr(:extra, :list, required: true)
  attr(:snap, :any, required: true)

  @doc "Describes one stream and the visualizers that accept it."
  def stream_properties(assigns) do
    ~H"""
    <h2>{@stream.name}</h2>
    <div class="sub">{@stream.type}</div>
    <.figure_list figures={StreamTotals.sum_streams([@stream])} />
    <dl>
      <dt :if={@stream.keys != []}>Lanes</dt><dd :if={@stream.keys != []}>{Enum.join(@stream.keys, ", ")}</dd>
      <div :for={{name, value} <- @stream.details} style="display: contents"><dt>{name}</dt><dd><.detail_value
          value={value} /></dd></div>
    </dl>
    <div class="hint">Show as</div>
    <div class="choices">
      <button :for={v <- Visualizers.for_shape(@stream.shape, @extra)} class="btn" type="button"
          phx-click="add_viz" phx-value-stream={@stream.name} phx-value-viz={v.id}>{v.title}</button>
    </div>
    <div class="choices">
      <button class="btn" type="button" phx-click="snap" phx-value-stream={@stream.name}
          aria-pressed={to_string(@snap == @stream.name)}>
          {if @snap == @stream.name, do: "Release the cursor", else: "Snap the cursor to this stream"}</button>
      <button :if={@stream.first} class="btn" type="button" phx-click="zoom_stream"
          phx-value-stream={@stream.name}>Zoom to stream</button>
    </div>
    """
  end
end
