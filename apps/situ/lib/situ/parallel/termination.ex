defmodule Situ.Parallel.Termination do
  @moduledoc false
  # Decides when the branch of a key ends, by the rules of `until:`. Pure.

  @enforce_keys [:rule]
  defstruct [:rule, :last_time, absences: %{}]

  @typedoc "The rule, the time of the last message, and how many messages each absent key has been absent."
  @type t :: %__MODULE__{
          rule:
            :never
            | {:after_absent, non_neg_integer()}
            | (term(), map(), Situ.Time.t() -> :keep | {:close, Situ.Time.t()}),
          last_time: Situ.Time.t() | nil,
          absences: %{term() => pos_integer()}
        }

  @doc "Parses an `until:` option."
  @spec parse_rule(term()) :: t()
  def parse_rule(:absent), do: %__MODULE__{rule: {:after_absent, 0}}
  def parse_rule(:never), do: %__MODULE__{rule: :never}

  def parse_rule({:absent, n}) when is_integer(n) and n >= 0,
    do: %__MODULE__{rule: {:after_absent, n}}

  def parse_rule(fun) when is_function(fun, 3), do: %__MODULE__{rule: fun}

  def parse_rule(other) do
    raise ArgumentError,
          "until: must be :absent, {:absent, n}, :never or a function of key, map and time, got: #{inspect(other)}"
  end

  @doc """
  Decides which of the live `branches` end at a message with these parts. Returns their keys, each with the time at
  which its branch ends.
  """
  @spec end_keys(t(), %{term() => term()}, list() | map(), Situ.Time.t()) ::
          {[{term(), Situ.Time.t()}], t()}
  def end_keys(%{rule: :never} = state, _branches, _parts, _time), do: {[], state}
  def end_keys(state, _branches, parts, _time) when is_list(parts), do: {[], state}

  def end_keys(%{rule: {:after_absent, limit}} = state, branches, parts, time) do
    absent = :maps.fold(&add_absent(&1, &2, &3, parts), [], branches)
    counted = for key <- absent, do: {key, Map.get(state.absences, key, 0) + 1}
    {kept, ended} = Enum.split_with(counted, fn {_key, n} -> n <= limit end)

    # A branch that lives now was alive at the last message, too.
    {for({key, _n} <- ended, do: {key, state.last_time}),
     %{state | absences: :maps.from_list(kept), last_time: time}}
  end

  def end_keys(%{rule: rule} = state, branches, parts, time) do
    ended =
      for key <- Map.keys(branches), {:close, at} <- [rule.(key, parts, time)], do: {key, at}

    {ended, state}
  end

  defp add_absent(key, _branch, keys, parts) when is_map_key(parts, key), do: keys
  defp add_absent(key, _branch, keys, _parts), do: [key | keys]
end
