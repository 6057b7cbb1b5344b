defmodule Situ.Studio.Visualizer do
  @moduledoc """
  Defines a way to draw a stream: the shapes it accepts, its options, and how it reads and encodes the data to draw.

  A visualizer with a time axis (`panel: :plot` or `:lanes`) implements `window/6` and reads an interval from the
  source. A visualizer at the cursor (`:image`, `:value`, `:bars`, `:text`) implements `instant/3` and encodes one
  message. Its counterpart is the module of the same name in `assets/js/visualizers`, which draws the frame, reports
  the value under the mouse and writes the legend. A custom visualizer can reuse one of the page's drawers with
  `drawer:`:

      defmodule Celsius do
        @behaviour Situ.Studio.Visualizer
        alias Situ.Studio.{Frame, Visualizer}

        @impl true
        def about,
          do: %Visualizer{id: "celsius", title: "Celsius", panel: :plot, shapes: [:signal], drawer: "line"}

        @impl true
        def window(source, channel, spec, from, to, bin) do
          with {:ok, _, bins} <- Situ.Store.summary(source, spec.stream, from, to, max(div(to - from, bin), 1)) do
            points = for {t, min, max, last, n} <- bins, do: {t, celsius(min), celsius(max), celsius(last), n}
            Frame.series(channel, points, false)
          end
        end

        defp celsius(fahrenheit), do: (fahrenheit - 32) / 1.8
      end

      Situ.Studio.start_link(visualizers: [Celsius])

  The shapes of streams are:

  | shape | messages |
  |---|---|
  | `:signal`, `:boolean`, `:state`, `:text` | numbers, booleans, atoms, strings |
  | `:signals`, `:states` | maps of numbers; maps of booleans, atoms or strings |
  | `:bars` | lists of numbers |
  | `:audio`, `:image`, `:depth` | audio buffers, images, depth images |
  | `:shapes`, `:masks` | rectangles and points over images; lists of masks over images |
  | `:spans` | time intervals |
  | `:space`, `:frames` | poses, clouds, skeletons and other objects in space; `Situ.Transform`s |
  | `:place` | geographic positions |
  | `:value` | any other term |
  """
  alias Situ.Studio.{Frame, StreamInfo}

  @enforce_keys [:id, :title, :panel, :shapes]
  defstruct [:id, :title, :panel, :shapes, :module, :drawer, options: []] ++
              [plugin: nil, script: nil, adapter: nil, data: :message, asks: [], problem: nil]

  @typedoc """
  `shapes` is a list of stream shapes, or `:any`. `options` describes the visualizer's properties. Each has a `type`
  (`:boolean`, `:color`, `:text`, `{:in, [text | {text, title}]}` or `{:range, min, max}`), a `title`, optionally a
  `default`, and optionally `only: {key, value}` if it applies only while another property has that value.

  The other fields are for plug-ins (`Situ.Studio.Plugins`): the `plugin` that contains it, the address of the
  `script` that draws it in the page, the `adapter` that converts each message, whether its script receives the
  `:message` at the cursor or the `:past` before it, the properties that the page sends with its requests (`asks`),
  and the `problem` of a visualizer that could not be loaded.
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
  @type definition :: module() | t()

  @typedoc "The stream to draw, the part of its messages (also as text), and the properties from the page."
  @type spec :: %{
          required(:stream) => String.t(),
          required(:viz) => t() | nil,
          required(:path) => Situ.Studio.ValuePath.t(),
          optional(:text) => String.t() | nil,
          optional(:props) => map()
        }

  @typedoc """
  The source of a message, the channel it is drawn for, and the parts of earlier messages that the page has cached, by
  name with their sizes.
  """
  @type context :: %{
          required(:source) => Situ.Recording.t(),
          required(:spec) => spec(),
          optional(:cache) => %{binary() => pos_integer()}
        }

  @doc "Returns the visualizer's description. `module` is filled in; `drawer` defaults to `id`."
  @callback about() :: t()

  @doc "Returns the frame of the window `from..to`, times in ns and inclusive, with bins of `bin` ns."
  @callback window(
              Situ.Recording.t(),
              Frame.channel(),
              spec(),
              Situ.Time.t(),
              Situ.Time.t(),
              bin :: pos_integer()
            ) :: Frame.t() | {:error, Situ.Error.t()}

  @doc "Returns the frame of one message; `data` is the part of it at the channel's path."
  @callback instant(Frame.channel(), data :: term(), Situ.Message.t()) ::
              Frame.t() | {:error, String.t()}

  @doc """
  Does the same as `c:instant/3`, for visualizers that also need the source or the properties of the channel.
  `{:cache, frame, cache}` also returns the parts that the page caches after that frame.
  """
  @callback instant(Frame.channel(), data :: term(), Situ.Message.t(), context()) ::
              Frame.t() | {:cache, Frame.t(), map() | nil} | {:error, String.t()}

  @typedoc "The value of a stream at a time: a frame, and a mark that differs for each message."
  @type value :: {:ok, mark :: term(), Frame.t()} | :none | {:error, Situ.Error.t()}

  @doc """
  Returns the exact value at the cursor for a visualizer with a time axis: the value of the latest message at or
  before the cursor, never of a summary.
  """
  @callback value_at(Situ.Recording.t(), Frame.channel(), spec(), Situ.Time.t()) :: value()

  @optional_callbacks window: 6, instant: 3, instant: 4, value_at: 4

  @doc "Returns the complete description of a visualizer, given a module or a description."
  @spec to_visualizer(definition()) :: t()
  def to_visualizer(%__MODULE__{} = visualizer),
    do: %{visualizer | drawer: visualizer.drawer || visualizer.id}

  def to_visualizer(module) do
    about = module.about()
    %{about | module: module, drawer: about.drawer || about.id}
  end

  @doc """
  Returns the properties that apply, given the values of all properties.

      iex> range = [type: {:in, ["auto", "fixed"]}, default: "auto", title: "Range"]
      iex> min = [type: {:range, 0, 10}, default: 0, title: "Minimum", only: {:range, "fixed"}]
      iex> depth = %Situ.Studio.Visualizer{id: "depth", title: "Depth", panel: :image, shapes: [:depth],
      ...>   options: [range: range, min: min]}
      iex> Keyword.keys(Situ.Studio.Visualizer.active_options(depth, %{}))
      [:range]
      iex> Keyword.keys(Situ.Studio.Visualizer.active_options(depth, %{"range" => "fixed"}))
      [:range, :min]
  """
  @spec active_options(t(), map()) :: keyword()
  def active_options(%__MODULE__{options: options}, props) do
    Enum.filter(options, fn {_, option} ->
      case option[:only] do
        nil -> true
        {key, value} -> Map.get(props, to_string(key), options[key][:default]) == value
      end
    end)
  end

  @doc """
  Returns the value of every property: the page's value (untrusted JSON) if it is valid, otherwise the default.

      iex> trail = %Situ.Studio.Visualizer{id: "trail", title: "Trail", panel: :image, shapes: [:shapes],
      ...>   options: [seconds: [type: {:range, 1, 60}, default: 10], opacity: [type: {:range, 0, 100}, default: 100]]}
      iex> Situ.Studio.Visualizer.property_values(trail, %{"seconds" => 2, "opacity" => "much"})
      %{seconds: 2, opacity: 100}
  """
  @spec property_values(t(), map()) :: %{atom() => term()}
  def property_values(%__MODULE__{options: options}, props) do
    Map.new(options, fn {key, option} ->
      value = Map.get(props, Atom.to_string(key))
      {key, if(valid_value?(option[:type], value), do: value, else: option[:default])}
    end)
  end

  defp valid_value?(:boolean, value), do: is_boolean(value)
  defp valid_value?({:range, low, high}, x), do: is_number(x) and x >= low and x <= high
  defp valid_value?({:in, values}, value), do: List.keymember?(choice_pairs(values), value, 0)
  defp valid_value?(_text, value), do: is_binary(value)

  @doc "Returns the values of a choice with their titles."
  @spec choice_pairs([String.t() | {String.t(), String.t()}]) :: [{String.t(), String.t()}]
  def choice_pairs(values) do
    Enum.map(values, fn
      {value, title} -> {value, title}
      value -> {value, value}
    end)
  end

  @doc """
  Validates and converts the value of one property from a form.

      iex> line = %Situ.Studio.Visualizer{id: "line", title: "Line", panel: :plot, shapes: [:signal],
      ...>   options: [width: [type: {:range, 1, 5}, default: 1]]}
      iex> Situ.Studio.Visualizer.cast_property(line, "width", "2.5")
      {:ok, 2.5}
      iex> Situ.Studio.Visualizer.cast_property(line, "width", "thick")
      :error
  """
  @spec cast_property(t(), String.t(), String.t()) :: {:ok, term()} | :error
  def cast_property(%__MODULE__{options: options}, name, text) do
    case Enum.find(options, fn {key, _} -> Atom.to_string(key) == name end) do
      {_, option} -> cast_type(option[:type], text)
      nil -> :error
    end
  end

  defp cast_type(:boolean, text) when text in ["true", "on"], do: {:ok, true}
  defp cast_type(:boolean, text) when text in ["false", ""], do: {:ok, false}
  defp cast_type(:text, text) when byte_size(text) <= 40, do: {:ok, text}

  defp cast_type({:in, values}, text),
    do: if(List.keymember?(choice_pairs(values), text, 0), do: {:ok, text}, else: :error)

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
