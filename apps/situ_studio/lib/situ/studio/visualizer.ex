defmodule Situ.Studio.Visualizer do
  @moduledoc """
  One way to draw a stream: the shapes it takes, its options, and how it reads and encodes what the page draws.

  A visualizer over time (`panel: :plot` or `:lanes`) has `window/6` and reads an interval from the source; one at the
  cursor (`:image`, `:value`, `:bars`, `:text`) has `instant/3` and encodes one message. Its other half is the module of
  the same name under `assets/js/visualizers`, which draws the frame, tells what lies under the mouse and writes the
  legend. A visualizer of your own that one of the page's drawers can draw names it in `drawer:`:

      defmodule Celsius do
        @behaviour Situ.Studio.Visualizer
        alias Situ.Studio.{Draw, Frame, Visualizer}

        @impl true
        def about,
          do: %Visualizer{id: "celsius", title: "Celsius", panel: :plot, shapes: [:signal], drawer: "line"}

        @impl true
        def window(source, channel, spec, from, to, _bin) do
          with {:ok, messages} <- Draw.Messages.around(source, spec, from, to) do
            points = for m <- messages, do: Draw.Bins.point(m.originating_time, (m.data - 32) / 1.8)
            Frame.series(channel, points, true)
          end
        end
      end

      Situ.Studio.start_link(visualizers: [Celsius])
  """
  alias Situ.Studio.{Frame, Source, StreamInfo}

  @enforce_keys [:id, :title, :panel, :shapes]
  defstruct [:id, :title, :panel, :shapes, :module, :drawer, options: []] ++
              [plugin: nil, script: nil, adapter: nil, data: :message, asks: [], problem: nil]

  @typedoc """
  `shapes` is a list of stream shapes, or `:any`. `options` describes its properties: each has a `type` (`:boolean`,
  `:color`, `:text`, `{:in, [text | {text, title}]}` or `{:range, min, max}`), a `title`, perhaps a `default`, and
  `only: {key, value}` where it means something only while another has that value.

  The rest is for what others add (`Situ.Studio.Plugins`): the `plugin` it came with, the address of the `script` that
  draws it in the page, the `adapter` that makes of each message what it takes, whether its script is told the
  `:message` at the cursor or the `:past` before it, the properties that the page
  `asks` with, and the `problem` of one that could not be loaded.
  """
  @type t :: %__MODULE__{
          id: String.t(),
          title: String.t(),
          panel: atom(),
          shapes: [StreamInfo.shape()] | :any,
          module: module() | nil,
          drawer: String.t() | nil,
          options: keyword(),
          plugin: String.t() | nil,
          script: String.t() | nil,
          adapter: module() | nil,
          data: :message | :past,
          asks: [atom()],
          problem: String.t() | nil
        }

  @typedoc "A module with this behaviour, or a visualizer's description."
  @type given :: module() | t()

  @typedoc "The stream to draw, the part of its messages, and the properties that the page gave."
  @type spec :: %{
          required(:stream) => String.t(),
          required(:viz) => t() | nil,
          required(:path) => Situ.Studio.Path.t(),
          optional(:props) => map()
        }

  @typedoc """
  Where a message came from, for which channel it is drawn, and which parts of earlier messages its page holds: names
  with their bytes.
  """
  @type context :: %{
          required(:source) => Source.t(),
          required(:spec) => spec(),
          optional(:kept) => %{binary() => pos_integer()}
        }

  @doc "The visualizer's description. The table fills in `module`; `drawer` is its `id` unless it names another."
  @callback about() :: t()

  @doc "The frame of the window `from..to`, times in ns and inclusive, with bins of `bin` ns."
  @callback window(
              Source.t(),
              Frame.channel(),
              spec(),
              Situ.Time.t(),
              Situ.Time.t(),
              bin :: pos_integer()
            ) :: Frame.t() | {:error, Situ.Error.t()}

  @doc "The frame of one message; `data` is the part of it that the channel's path names."
  @callback instant(Frame.channel(), data :: term(), Situ.Message.t()) ::
              Frame.t() | {:error, String.t()}

  @doc """
  As `c:instant/3`, for what needs more than the message: the source, and the properties of the channel. `{:kept, frame,
  kept}` also says what the page holds after that frame.
  """
  @callback instant(Frame.channel(), data :: term(), Situ.Message.t(), context()) ::
              Frame.t() | {:kept, Frame.t(), map() | nil} | {:error, String.t()}

  @typedoc "The value of a stream at a time: a frame, and a mark that is different for each message."
  @type value :: {:ok, mark :: term(), Frame.t()} | :none | {:error, Situ.Error.t()}

  @doc """
  Returns the exact value that a visualizer over time has at the cursor: that of the latest message at or before it,
  never that of a summary (`Situ.Studio.Draw.Values`).
  """
  @callback value_at(Source.t(), Frame.channel(), spec(), Situ.Time.t()) :: value()

  @optional_callbacks window: 6, instant: 3, instant: 4, value_at: 4

  @doc "The description of a module, complete."
  @spec of(given()) :: t()
  def of(%__MODULE__{} = visualizer),
    do: %{visualizer | drawer: visualizer.drawer || visualizer.id}

  def of(module) do
    about = module.about()
    %{about | module: module, drawer: about.drawer || about.id}
  end

  @doc """
  The properties that mean something, given the values of all.

      iex> {:ok, depth} = Situ.Studio.Visualizers.fetch("depth", :depth)
      iex> Keyword.has_key?(Situ.Studio.Visualizer.options(depth, %{}), :min)
      false
      iex> Keyword.has_key?(Situ.Studio.Visualizer.options(depth, %{"range" => "fixed"}), :min)
      true
  """
  @spec options(t(), map()) :: keyword()
  def options(%__MODULE__{options: options}, props) do
    Enum.filter(options, fn {_, option} ->
      case option[:only] do
        nil -> true
        {key, value} -> Map.get(props, to_string(key), options[key][:default]) == value
      end
    end)
  end

  @doc """
  The value of every property: as a page gave it (from JSON: anything), or the default where that is none.

      iex> {:ok, trail} = Situ.Studio.Visualizers.named("trail", [])
      iex> settings = Situ.Studio.Visualizer.settings(trail, %{"seconds" => 2, "opacity" => "much"})
      iex> {settings.seconds, settings.opacity}
      {2, 100}
  """
  @spec settings(t(), map()) :: %{atom() => term()}
  def settings(%__MODULE__{options: options}, props) do
    Map.new(options, fn {key, option} ->
      value = Map.get(props, Atom.to_string(key))
      {key, if(fits?(option[:type], value), do: value, else: option[:default])}
    end)
  end

  defp fits?(:boolean, value), do: is_boolean(value)
  defp fits?({:range, low, high}, x), do: is_number(x) and x >= low and x <= high
  defp fits?({:in, values}, value), do: List.keymember?(choices(values), value, 0)
  defp fits?(_text, value), do: is_binary(value)

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
      iex> Situ.Studio.Visualizer.cast(line, "width", "2.5")
      {:ok, 2.5}
      iex> Situ.Studio.Visualizer.cast(line, "width", "thick")
      :error
  """
  @spec cast(t(), String.t(), String.t()) :: {:ok, term()} | :error
  def cast(%__MODULE__{options: options}, name, text) do
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
