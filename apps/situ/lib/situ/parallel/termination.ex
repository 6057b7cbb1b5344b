defmodule Situ.Parallel.Termination do
  @moduledoc false
  # Decides when the branch of a key ends, by the rules of `until:`. Pure.

  @type t ::
          :never
          | {:after_absent, non_neg_integer()}
          | (term(), map(), Situ.Time.t() -> :keep | {:close, Situ.Time.t()})

  @doc "Parses an `until:` option."
  @spec parse_rule(term()) :: t()
  def parse_rule(:absent), do: {:after_absent, 0}
  def parse_rule(:never), do: :never
  def parse_rule({:absent, n}) when is_integer(n) and n >= 0, do: {:after_absent, n}
  def parse_rule(fun) when is_function(fun, 3), do: fun

  def parse_rule(other) do
    raise ArgumentError,
          "until: must be :absent, {:absent, n}, :never or a function of key, map and time, got: #{inspect(other)}"
  end

  @doc "Returns the keys of `branches` that the rule must check at a message with these parts."
  @spec keys_to_check(t(), %{term() => term()}, map()) :: [term()]
  def keys_to_check(:never, _branches, _parts), do: []
  def keys_to_check(rule, branches, _parts) when is_function(rule), do: Map.keys(branches)

  def keys_to_check(_rule, branches, parts) do
    :maps.fold(
      fn key, _, keys -> if is_map_key(parts, key), do: keys, else: [key | keys] end,
      [],
      branches
    )
  end

  @doc """
  Decides whether the branch of a key ends. `seen` is the time at which the key was last seen, and `absent` the number
  of messages without it since then. Returns `:keep`, `{:absent, n}` (the branch stays, with the key absent for the n-th
  time), or `{:close, time}`.
  """
  @spec decide_branch(t(), term(), {Situ.Time.t() | nil, non_neg_integer()}, map(), Situ.Time.t()) ::
          :keep | {:absent, pos_integer()} | {:close, Situ.Time.t() | nil}
  def decide_branch({:after_absent, limit}, _key, {seen, absent}, _parts, _time) do
    if absent + 1 > limit, do: {:close, seen}, else: {:absent, absent + 1}
  end

  def decide_branch(rule, key, _presence, parts, time) when is_function(rule, 3),
    do: rule.(key, parts, time)
end
