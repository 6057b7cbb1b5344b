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
  @spec parse(term(), term(), term(), keyword()) :: {streams(), term(), keyword()}
  def parse(first, second, third, opts) when is_list(first) do
    {interpolator, opts} = last(second, third, opts)
    {{:vector, some!(first)}, interpolator, opts}
  end

  def parse(%Stream{} = primary, %Stream{} = secondary, third, opts) do
    {interpolator, opts} = last(third, opts, [])
    {{:one, primary, secondary}, interpolator, opts}
  end

  def parse(%Stream{} = primary, secondaries, third, opts) when is_list(secondaries) do
    {interpolator, opts} = last(third, opts, [])
    {{:many, primary, some!(secondaries)}, interpolator, opts}
  end

  def parse(%Stream{} = primary, %{} = keyed, third, opts) when not is_struct(keyed) do
    {interpolator, opts} = last(third, opts, [])
    if keyed != %{}, do: some!(Map.values(keyed))
    {{:keyed, primary, keyed}, interpolator, opts}
  end

  def parse(other, _second, _third, _opts),
    do: Argument.refuse!(other, :streams, "Situ.join(primary, secondary)")

  defp last(opts, [], []) when is_list(opts) do
    if Keyword.keyword?(opts), do: {:default, opts}, else: {opts, []}
  end

  defp last([], opts, []), do: {:default, opts}
  defp last(interpolator, opts, []), do: {interpolator, opts}
  defp last(interpolator, [], opts), do: {interpolator, opts}

  defp last(_interpolator, other, _opts) do
    raise ArgumentError,
          "expected streams, an interpolator and a keyword list of options, got: #{inspect(other, limit: 5)}"
  end

  @doc "Returns the interpolator given by the user, or the default."
  @spec given(term(), Interpolator.t() | :none) :: Interpolator.t() | [Interpolator.t()]
  def given(:default, :none),
    do: raise(ArgumentError, "fuse needs an interpolator; see Situ.join/4")

  def given(:default, default), do: default
  def given(list, _default) when is_list(list), do: Enum.map(list, &interpolator/1)
  def given(other, _default), do: interpolator(other)

  @doc "Converts an interpolator, a tolerance (ns) or a window; the last two mean `Situ.Reproducible.nearest/1`."
  @spec interpolator(Interpolator.t() | Situ.Time.duration() | Interval.t()) :: Interpolator.t()
  def interpolator(%Interpolator{} = interpolator), do: interpolator
  def interpolator(tolerance) when is_integer(tolerance), do: Reproducible.nearest(tolerance)
  def interpolator(%Interval{} = window), do: Reproducible.nearest(window)

  def interpolator(other) do
    raise ArgumentError,
          "expected an interpolator, a tolerance in ns or a Situ.Interval, got: #{inspect(other)}"
  end

  @doc "Raises if the results of an interpolator can depend on timing."
  @spec reproducible!(Interpolator.t()) :: :ok
  def reproducible!(%Interpolator{reproducible: true}), do: :ok
  def reproducible!(interpolator), do: raise(not_reproducible(interpolator))

  @doc "Returns the error for an interpolator that is not reproducible."
  @spec not_reproducible(Interpolator.t()) :: Error.t()
  def not_reproducible(interpolator) do
    Error.new(
      :not_reproducible,
      "join needs a reproducible interpolator, got: #{inspect(interpolator.module)}",
      why: "the results of other interpolators depend on which messages have arrived",
      fix: "use Situ.Reproducible, or Situ.fuse/4 if results may depend on timing"
    )
  end

  @doc "Returns one interpolator for each of `n` secondaries."
  @spec each(Interpolator.t() | [Interpolator.t()], non_neg_integer()) :: [Interpolator.t()]
  def each(%Interpolator{} = one, n), do: List.duplicate(one, n)
  def each(list, n) when length(list) == n, do: list

  def each(list, n),
    do: raise(ArgumentError, "#{length(list)} interpolators for #{n} secondary streams")

  @doc "Returns the primary and secondary streams of any form."
  @spec sides(streams()) :: {Stream.t(), [Stream.t()]}
  def sides({:one, primary, secondary}), do: {primary, [secondary]}
  def sides({:many, primary, secondaries}), do: {primary, secondaries}
  def sides({:keyed, primary, keyed}), do: {primary, Map.values(keyed)}
  def sides({:vector, [primary | secondaries]}), do: {primary, secondaries}

  @doc "Parses the arguments of zip and merge."
  @spec inputs(term(), term(), keyword()) :: {[Stream.t()], keyword()}
  def inputs(%Stream{} = first, %Stream{} = second, opts), do: {[first, second], opts}
  def inputs(streams, opts, []) when is_list(streams), do: {some!(streams), opts}

  def inputs(other, _second, _opts),
    do: Argument.refuse!(other, :streams, "Situ.zip(first, second)")

  defp some!([]), do: raise(ArgumentError, "no streams given: there is nothing to combine")

  defp some!(streams) do
    if Enum.all?(streams, &is_struct(&1, Stream)),
      do: streams,
      else: raise(ArgumentError, "expected streams, got: #{inspect(streams, limit: 5)}")
  end
end
