defmodule Situ.Studio.Visualizers do
  @moduledoc """
  The table from kinds of streams to what can be drawn of them; the first visualizer that fits is what "add" takes.

  A visualizer names its panel (`:plot`, `:lanes` on the time axis; `:image`, `:value`, `:bars`, `:text` at the cursor)
  and the drawing primitive the page knows. Others are added by handing their entries to `Situ.Studio` as
  `visualizers: [%Situ.Studio.Visualizers.Entry{...}]`.

      iex> for v <- Situ.Studio.Visualizers.for_shape(:boolean), do: v.id
      ["states", "line", "value", "messages", "latency"]
  """

  defmodule Entry do
    @moduledoc """
    One row of the table. `shapes` is a list of stream shapes, or `:any`; `options` describes its properties: each has a
    `type` (`:boolean`, `:color`, `:text`, `{:in, [text | {text, title}]}` or `{:range, min, max}`), a `title`, perhaps a
    `default`, and `only: {key, value}` where it means something only while another has that value.
    """
    @enforce_keys [:id, :title, :panel, :draw, :shapes]
    defstruct [:id, :title, :panel, :draw, :shapes, options: []]

    @type t :: %__MODULE__{
            id: String.t(),
            title: String.t(),
            panel: atom(),
            draw: String.t(),
            shapes: [Situ.Studio.StreamInfo.shape()] | :any,
            options: keyword()
          }
  end

  @color [color: [type: :color, title: "Colour"]]
  @visible [visible: [type: :boolean, title: "Visible", default: true]]

  @line @visible ++
          @color ++
          [
            interpolation: [
              type: {:in, [{"direct", "straight"}, {"step", "steps"}, {"none", "points only"}]},
              title: "Joins",
              default: "direct"
            ],
            width: [type: {:range, 0.5, 6}, title: "Width", default: 1.25],
            markers: [type: :boolean, title: "Markers", default: false],
            unit: [type: :text, title: "Unit"]
          ]

  @lines Keyword.delete(@line, :color)

  @flip [flip: [type: :boolean, title: "Mirror", default: false]]

  @ranges [
    {"auto", "each picture's own range"},
    {"fixed", "a fixed range"},
    {"all", "all 16 bits"},
    {"nfov_binned", "Azure Kinect, narrow, binned"},
    {"nfov", "Azure Kinect, narrow"},
    {"wfov_binned", "Azure Kinect, wide, binned"},
    {"wfov", "Azure Kinect, wide"}
  ]

  @depth @visible ++
           @flip ++
           [
             range: [type: {:in, @ranges}, title: "Range", default: "auto"],
             min: [type: {:range, 0, 65_535}, title: "from", default: 0, only: {:range, "fixed"}],
             max: [
               type: {:range, 0, 65_535},
               title: "to",
               default: 65_535,
               only: {:range, "fixed"}
             ],
             invalid: [type: {:range, -1, 65_535}, title: "No reading is", default: 0],
             invalid_color: [type: :color, title: "drawn in", auto: "see-through"],
             scale: [type: :boolean, title: "Colour scale", default: true]
           ]

  @over @visible ++
          @color ++
          [
            labels: [type: :boolean, title: "Labels", default: true],
            width: [type: {:range, 0.5, 8}, title: "Width", default: 2],
            radius: [type: {:range, 0.5, 20}, title: "Point radius"]
          ]

  @table [
    %{id: "line", title: "Line", panel: :plot, draw: "line", shapes: [:signal], options: @line},
    %{
      id: "waveform",
      title: "Waveform",
      panel: :plot,
      draw: "waveform",
      shapes: [:audio],
      options: @visible ++ @color ++ [mute: [type: :boolean, title: "Mute", default: false]]
    },
    %{
      id: "lines",
      title: "Lines",
      panel: :plot,
      draw: "lines",
      shapes: [:signals],
      options: @lines
    },
    %{
      id: "states",
      title: "States",
      panel: :lanes,
      draw: "segments",
      shapes: [:boolean, :state, :states]
    },
    %{id: "spans", title: "Intervals", panel: :lanes, draw: "spans", shapes: [:spans]},
    %{id: "labels", title: "Labels", panel: :lanes, draw: "segments", shapes: [:text]},
    %{
      id: "image",
      title: "Picture",
      panel: :image,
      draw: "image",
      shapes: [:image],
      options: @visible ++ @flip
    },
    %{
      id: "depth",
      title: "Depth",
      panel: :image,
      draw: "depth",
      shapes: [:depth],
      options: @depth
    },
    %{
      id: "shapes",
      title: "Shapes over pictures",
      panel: :image,
      draw: "shapes",
      shapes: [:shapes],
      options: @over
    },
    %{
      id: "bars",
      title: "Bars",
      panel: :bars,
      draw: "bars",
      shapes: [:bars, :signals],
      options: @color
    },
    %{id: "text", title: "Text", panel: :text, draw: "text", shapes: [:text]},
    %{
      id: "line",
      title: "Line",
      panel: :plot,
      draw: "line",
      shapes: [:boolean],
      options: @line
    },
    %{id: "value", title: "Value", panel: :value, draw: "value", shapes: :any},
    %{
      id: "messages",
      title: "Messages",
      panel: :lanes,
      draw: "marks",
      shapes: :any,
      options: @color
    },
    %{
      id: "latency",
      title: "Latency",
      panel: :plot,
      draw: "latency",
      shapes: :any,
      options:
        @visible ++
          @color ++ [threshold_ms: [type: {:range, 0, 1.0e6}, title: "Limit, ms", default: 50]]
    }
  ]

  @doc "The built-in rows."
  @spec all() :: [Entry.t()]
  def all, do: Enum.map(@table, &struct!(Entry, &1))

  @doc "What can be drawn of a stream of this shape, the usual one first; `extra` rows come before the built-in ones."
  @spec for_shape(Situ.Studio.StreamInfo.shape(), [Entry.t()]) :: [Entry.t()]
  def for_shape(shape, extra \\ []),
    do: Enum.filter(extra ++ all(), &(&1.shapes == :any or shape in &1.shapes))

  @doc "The visualizer `id` for this shape."
  @spec fetch(String.t(), Situ.Studio.StreamInfo.shape(), [Entry.t()]) ::
          {:ok, Entry.t()} | :error
  def fetch(id, shape, extra \\ []) do
    case Enum.find(for_shape(shape, extra), &(&1.id == id)) do
      nil -> :error
      entry -> {:ok, entry}
    end
  end

  @doc "The visualizer of something in a layout; of a part of a message, any may be wanted."
  @spec of(String.t(), String.t(), Situ.Studio.StreamInfo.shape(), [Entry.t()]) ::
          {:ok, Entry.t()} | :error
  def of(id, "", shape, extra), do: fetch(id, shape, extra)

  def of(id, _path, _shape, extra) do
    case Enum.find(extra ++ all(), &(&1.id == id)) do
      nil -> :error
      entry -> {:ok, entry}
    end
  end

  @doc """
  The properties that mean something, given the values of all.

      iex> {:ok, depth} = Situ.Studio.Visualizers.fetch("depth", :depth)
      iex> Keyword.has_key?(Situ.Studio.Visualizers.options(depth, %{}), :min)
      false
      iex> Keyword.has_key?(Situ.Studio.Visualizers.options(depth, %{"range" => "fixed"}), :min)
      true
  """
  @spec options(Entry.t(), map()) :: keyword()
  def options(%Entry{options: options}, props) do
    Enum.filter(options, fn {_, option} ->
      case option[:only] do
        nil -> true
        {key, value} -> Map.get(props, to_string(key), options[key][:default]) == value
      end
    end)
  end

  @doc "The values of a choice, with what people read."
  @spec choices([String.t() | {String.t(), String.t()}]) :: [{String.t(), String.t()}]
  def choices(values) do
    Enum.map(values, fn
      {value, title} -> {value, title}
      value -> {value, value}
    end)
  end

  @doc """
  Checks one property as a form sends it.

      iex> {:ok, line} = Situ.Studio.Visualizers.fetch("line", :signal)
      iex> Situ.Studio.Visualizers.cast(line, "width", "2.5")
      {:ok, 2.5}
      iex> Situ.Studio.Visualizers.cast(line, "width", "thick")
      :error
  """
  @spec cast(Entry.t(), String.t(), String.t()) :: {:ok, term()} | :error
  def cast(%Entry{options: options}, name, text) do
    case Enum.find(options, fn {key, _} -> Atom.to_string(key) == name end) do
      {_, option} -> cast_type(option[:type], text)
      nil -> :error
    end
  end

  defp cast_type(:boolean, text) when text in ["true", "on"], do: {:ok, true}
  defp cast_type(:boolean, text) when text in ["false", ""], do: {:ok, false}
  defp cast_type(:text, text) when byte_size(text) <= 40, do: {:ok, text}

  defp cast_type({:in, values}, text),
    do: if(List.keymember?(choices(values), text, 0), do: {:ok, text}, else: :error)

  defp cast_type(:color, text),
    do: if(text =~ ~r/\A#[0-9a-fA-F]{6}\z/, do: {:ok, text}, else: :error)

  defp cast_type({:range, min, max}, text) do
    case Float.parse(text) do
      {x, ""} when x >= min and x <= max -> {:ok, x}
      _ -> :error
    end
  end

  defp cast_type(_, _), do: :error
end
