defmodule Situ.Fusion.Arguments do
  @moduledoc false
  # Parses the forms of streams and interpolators that fusion operators accept. Pure.
  alias Situ.{Argument, Error, Interpolator, Interval, Reproducible, Stream}

  @type streams ::
          {:one, Stream.t(), Stream.t()}
          | {:many, Stream.t(), [Stream.t()]}
          | {:keyed, Stream.t(), %{term() => Stream.t()}}
          | {:vector, [Stream.t()]}

  @doc "Parses the arguments of join and fuse: a primary with its secondaries, or a list that begins with the primary."
  @spec parse_streams(term(), term(), term(), keyword()) :: {streams(), term(), keyword()}
  def parse_streams(first, second, third, opts) when is_list(first) do
    {interpolator, opts} = parse_trailing(second, third, opts)
    {{:vector, check_streams!(first)}, interpolator, opts}
  end

  def parse_streams(%Stream{} = primary, %Stream{} = secondary, third, opts) do
    {interpolator, opts} = parse_trailing(third, opts, [])
    {{:one, primary, secondary}, interpolator, opts}
  end

  def parse_streams(%Stream{} = primary, secondaries, third, opts) when is_list(secondaries) do
    {interpolator, opts} = parse_trailing(third, opts, [])
    {{:many, primary, check_streams!(secondaries)}, interpolator, opts}
  end

  def parse_streams(%Stream{} = primary, %{} = keyed, third, opts) when not is_struct(keyed) do
    {interpolator, opts} = parse_trailing(third, opts, [])
    if keyed != %{}, do: check_streams!(Map.values(keyed))
    {{:keyed, primary, keyed}, interpolator, opts}
  end

  def parse_streams(other, _second, _third, _opts),
    do: Argument.raise_invalid!(other, :streams, "Situ.join(primary, secondary)")

  defp parse_trailing(opts, [], []) when is_list(opts) do
    if Keyword.keyword?(opts), do: {:default, opts}, else: {opts, []}
  end

  defp parse_trailing([], opts, []), do: {:default, opts}
  defp parse_trailing(interpolator, opts, []), do: {interpolator, opts}
  defp parse_trailing(interpolator, [], opts), do: {interpolator, opts}

  defp parse_trailing(_interpolator, other, _opts) do
    raise ArgumentError,
          "expected streams, an interpolator and a keyword list of options, got: #{inspect(other, limit: 5)}"
  end

  @doc "Returns the interpolator given by the user, or the default."
  @spec resolve_interpolator(term(), Interpolator.t() | :none) ::
          Interpolator.t() | [Interpolator.t()]
  def resolve_interpolator(:default, :none),
    do: raise(ArgumentError, "fuse needs an interpolator; see Situ.join/4")

  def resolve_interpolator(:default, default), do: default

  def resolve_interpolator(list, _default) when is_list(list),
    do: Enum.map(list, &to_interpolator/1)

  def resolve_interpolator(other, _default), do: to_interpolator(other)

  @doc "Converts an interpolator, a tolerance (ns) or a window; the last two mean `Situ.Reproducible.nearest/1`."
  @spec to_interpolator(Interpolator.t() | Situ.Time.duration() | Interval.t()) ::
          Interpolator.t()
  def to_interpolator(%Interpolator{} = interpolator), do: interpolator
  def to_interpolator(tolerance) when is_integer(tolerance), do: Reproducible.nearest(tolerance)
  def to_interpolator(%Interval{} = window), do: Reproducible.nearest(window)

  def to_interpolator(other) do
    raise ArgumentError,
          "expected an interpolator, a tolerance in ns or a Situ.Interval, got: #{inspect(other)}"
  end

  @doc "Raises if the results of an interpolator can depend on timing."
  @spec ensure_reproducible!(Interpolator.t()) :: :ok
  def ensure_reproducible!(%Interpolator{reproducible: true}), do: :ok
  def ensure_reproducible!(interpolator), do: raise(not_reproducible_error(interpolator))

  @doc "Returns the error for an interpolator that is not reproducible."
  @spec not_reproducible_error(Interpolator.t()) :: Error.t()
  def not_reproducible_error(interpolator) do
    Error.new(
      :not_reproducible,
      "join needs a reproducible interpolator, got: #{inspect(interpolator.module)}",
      why: "the results of other interpolators depend on which messages have arrived",
      fix: "use Situ.Reproducible, or Situ.fuse/4 if results may depend on timing"
    )
  end

  @doc "Returns one interpolator for each of `n` secondaries."
  @spec interpolator_per_stream(Interpolator.t() | [Interpolator.t()], non_neg_integer()) :: [
          Interpolator.t()
        ]
  def interpolator_per_stream(%Interpolator{} = one, n), do: List.duplicate(one, n)
  def interpolator_per_stream(list, n) when length(list) == n, do: list

  def interpolator_per_stream(list, n),
    do: raise(ArgumentError, "#{length(list)} interpolators for #{n} secondary streams")

  @doc "Returns the primary and secondary streams of any form."
  @spec split_sides(streams()) :: {Stream.t(), [Stream.t()]}
  def split_sides({:one, primary, secondary}), do: {primary, [secondary]}
  def split_sides({:many, primary, secondaries}), do: {primary, secondaries}
  def split_sides({:keyed, primary, keyed}), do: {primary, Map.values(keyed)}
  def split_sides({:vector, [primary | secondaries]}), do: {primary, secondaries}

  @doc "Parses the arguments of zip and merge."
  @spec parse_inputs(term(), term(), keyword()) :: {[Stream.t()], keyword()}
  def parse_inputs(%Stream{} = first, %Stream{} = second, opts), do: {[first, second], opts}
  def parse_inputs(streams, opts, []) when is_list(streams), do: {check_streams!(streams), opts}

  def parse_inputs(other, _second, _opts),
    do: Argument.raise_invalid!(other, :streams, "Situ.zip(first, second)")

  defp check_streams!([]),
    do: raise(ArgumentError, "no streams given: there is nothing to combine")

  defp check_streams!(streams) do
    if Enum.all?(streams, &is_struct(&1, Stream)),
      do: streams,
      else: raise(ArgumentError, "expected streams, got: #{inspect(streams, limit: 5)}")
  end
end
