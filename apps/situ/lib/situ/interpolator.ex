defmodule Situ.Interpolator do
  @moduledoc """
  Decides which value a stream has at a given time, from its messages around that time.

  `Situ.Reproducible` and `Situ.Available` build the standard interpolators. A custom one is a module with this
  behaviour:

      defmodule Latest do
        @behaviour Situ.Interpolator

        # Returns the latest value at or before `time`, once a later message has arrived to prove it.
        @impl true
        def interpolate(time, messages, closed, _config) do
          {past, future} = Enum.split_while(messages, &(&1.originating_time <= time))

          cond do
            future == [] and closed == nil -> :insufficient_data
            past == [] -> {:does_not_exist, nil}
            true -> {:created, List.last(past).data, List.last(past).originating_time}
          end
        end
      end

      Situ.join(camera, gaze, Situ.Interpolator.new(Latest, nil, reproducible: true))

  ## Results

    * `{:created, value, obsolete}`: the value;
    * `{:does_not_exist, obsolete}`: the value does not exist and never will;
    * `:insufficient_data`: ask again when more messages have arrived;
    * `{:wait, time}`: the same, but only a message at or after `time` (or the end of the stream) can change the result.

  Messages strictly before `obsolete` are dropped, since later queries (which have later times) cannot need them; `nil`
  keeps all. `messages` are the queued messages in time order. `closed` is the time at which the stream ended, or
  `nil`.

  An interpolator is **reproducible** if its result does not depend on which messages had already arrived: it waits
  until no later message can change the result. `Situ.join/4` accepts only reproducible interpolators.
  """

  alias Situ.{Interval, Message, Type}

  @enforce_keys [:module, :config]
  defstruct [:module, :config, reproducible: false, gives: :values, default: :none]

  @type t :: %__MODULE__{
          module: module(),
          config: term(),
          reproducible: boolean(),
          gives: :messages | :values,
          default: :none | {:value, term()}
        }
  @type result ::
          {:created, term(), Situ.Time.t() | nil}
          | {:does_not_exist, Situ.Time.t() | nil}
          | {:wait, Situ.Time.t() | :infinity}
          | :insufficient_data

  @callback interpolate(
              Situ.Time.t(),
              [Message.t()],
              closed :: Situ.Time.t() | nil,
              config :: term()
            ) :: result()

  @doc """
  Builds an interpolator from a module of this behaviour and its configuration.

  Options: `reproducible:` (default false); `gives:` `:messages` if its values are data of the stream's messages (and so
  have the stream's type), otherwise `:values` (default); `or_default:` the value to use where none exists.
  """
  @spec new(module(), term(), keyword()) :: t()
  def new(module, config, opts \\ []) when is_atom(module) do
    %__MODULE__{
      module: module,
      config: config,
      reproducible: Keyword.get(opts, :reproducible, false),
      gives: Keyword.get(opts, :gives, :values),
      default: parse_default(opts)
    }
  end

  @doc "Returns the result at `time`, with the default in place of a value that does not exist."
  @spec interpolate(t(), Situ.Time.t(), [Message.t()], Situ.Time.t() | nil) :: result()
  def interpolate(%__MODULE__{} = interpolator, time, messages, closed) do
    case {interpolator.module.interpolate(time, messages, closed, interpolator.config),
          interpolator.default} do
      {{:does_not_exist, obsolete}, {:value, value}} -> {:created, value, obsolete}
      {result, _default} -> result
    end
  end

  @doc """
  Returns the type of the values that it produces from a stream of this type. A default of a different type widens it.

      iex> Situ.Interpolator.value_type(Situ.Reproducible.nearest(or_default: nil), :integer)
      {:optional, :integer}
      iex> Situ.Interpolator.value_type(Situ.Reproducible.linear(), :integer)
      :any
  """
  @spec value_type(t(), Type.t()) :: Type.t()
  def value_type(%__MODULE__{gives: :messages, default: default}, type),
    do: widen_type(type, default)

  def value_type(%__MODULE__{}, _type), do: :any

  @doc "Returns the type with a default among its values: `:none`, or `{:value, default}`."
  @spec widen_type(Type.t(), :none | {:value, term()}) :: Type.t()
  def widen_type(type, :none), do: type

  def widen_type(type, {:value, value}) do
    cond do
      Type.valid_value?(type, value) -> type
      value == nil -> {:optional, type}
      true -> :any
    end
  end

  @doc false
  # Parses the window argument of the constructors: an interval, a tolerance, or options in its place.
  @spec parse_window(Interval.t() | Situ.Time.duration() | keyword(), keyword(), Interval.t()) ::
          {Interval.t(), keyword()}
  def parse_window(%Interval{} = window, opts, _default) do
    if Interval.negative?(window) do
      raise ArgumentError,
            "the window #{window} ends before it begins; did you mean #{Interval.sort_ends(window)}?"
    end

    {window, validate_options(opts)}
  end

  def parse_window(tolerance, opts, _default) when is_integer(tolerance),
    do: {Interval.within(tolerance), validate_options(opts)}

  def parse_window(opts, [], default) when is_list(opts), do: {default, validate_options(opts)}

  def parse_window(other, _opts, _default) do
    raise ArgumentError,
          "expected a window: a Situ.Interval or a tolerance in whole ns, got: #{inspect(other)}"
  end

  defp validate_options(opts), do: Situ.Options.validate!(opts, or_default: [type: :any])

  defp parse_default(opts) do
    case Keyword.fetch(opts, :or_default) do
      {:ok, value} -> {:value, value}
      :error -> :none
    end
  end
end
