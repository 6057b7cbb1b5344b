defmodule Situ.Operator.Chain do
  @moduledoc false
  # A chain of light operators in one process. Only the data moves from step to step; the caller builds one envelope
  # at the end. A step that raises is identified by its index, so that the error names the operator that the user
  # wrote.

  @type step ::
          {atom(), fun(), index :: non_neg_integer()}
          | {atom(), fun(), index :: non_neg_integer(), term()}
  @type steps :: [step()]
  @skip :"$situ_skip"

  @enforce_keys [:steps, :fast]
  defstruct [:steps, :fast, :counters, sizes: false]

  @typedoc """
  The steps of a stage, and `fast`, which is true if no step keeps state. A chain that consumes a component's output
  also has the counters of the edge into the chain, and `sizes`, which is true if message sizes are measured.
  """
  @type t :: %__MODULE__{
          steps: steps(),
          fast: boolean(),
          counters: :atomics.atomics_ref() | nil,
          sizes: boolean()
        }

  @doc "Compiles the chain of `vertices`, which start at index `first` of their stage."
  @spec compile([Situ.Graph.Vertex.t()], non_neg_integer()) :: t()
  def compile(vertices, first) do
    steps = vertices |> Enum.map(& &1.opts) |> build_steps(first)
    %__MODULE__{steps: steps, fast: not stateful?(steps)}
  end

  @doc "Updates the steps of the chain with `fun`."
  @spec update_steps(t(), (steps() -> steps())) :: t()
  def update_steps(%__MODULE__{} = chain, fun) do
    steps = fun.(chain.steps)
    %{chain | steps: steps, fast: not stateful?(steps)}
  end

  @doc """
  Replaces the step of the operator at `index`. The state of the old step is discarded, or kept with `{:keep, step}`.
  """
  @spec replace_step(t(), non_neg_integer(), Situ.Operator.step() | {:keep, Situ.Operator.step()}) ::
          t()
  def replace_step(chain, index, {:keep, {:step, fun, _state}}) do
    update_steps(chain, fn steps ->
      Enum.map(steps, fn
        {:step, _old, ^index, state} -> {:step, fun, index, state}
        other -> other
      end)
    end)
  end

  def replace_step(chain, index, {:keep, step}), do: replace_step(chain, index, step)

  def replace_step(chain, index, step) do
    [fresh] = build_steps([step], index)

    update_steps(chain, fn steps ->
      Enum.map(steps, &if(elem(&1, 2) == index, do: fresh, else: &1))
    end)
  end

  @doc "Builds the steps of operators, in order; `first` is the index of the first operator's vertex in its stage."
  @spec build_steps([Situ.Operator.step()], non_neg_integer()) :: steps()
  def build_steps(steps, first \\ 0) do
    steps
    |> Enum.with_index(first)
    |> Enum.map(fn
      {{:step, fun, state}, i} -> {:step, fun, i, state}
      {{kind, fun}, i} -> {step_kind(kind, fun), fun, i}
    end)
  end

  @doc "Returns whether any step keeps state."
  @spec stateful?(steps()) :: boolean()
  def stateful?(steps), do: Enum.any?(steps, &(tuple_size(&1) == 4))

  @doc "Runs stateless steps on a message; returns data or `skip/0`. Throws `{:situ_step, index, kind, reason, stack}`."
  @spec run_stateless(steps(), term(), Situ.Message.t()) :: term()
  def run_stateless([], data, _message), do: data

  def run_stateless([{:map, fun, i} | rest], data, message) do
    value =
      try do
        fun.(data)
      catch
        kind, reason -> throw_failure(i, kind, reason, __STACKTRACE__)
      end

    run_stateless(rest, value, message)
  end

  def run_stateless([step | rest], data, message) do
    case apply_step(step, data, message) do
      {:emit, value} -> run_stateless(rest, value, message)
      @skip -> @skip
    end
  end

  @doc "Runs steps with state on a message; returns `{data | skip, steps}`."
  @spec run_stateful(steps(), term(), Situ.Message.t()) :: {term(), steps()}
  def run_stateful([], data, _message), do: {data, []}

  def run_stateful([{:step, fun, i, state} | rest], data, message) do
    result =
      try do
        fun.(data, message, state)
      catch
        kind, reason -> throw_failure(i, kind, reason, __STACKTRACE__)
      end

    case result do
      {:emit, value, state} ->
        {out, rest} = run_stateful(rest, value, message)
        {out, [{:step, fun, i, state} | rest]}

      {:skip, state} ->
        {@skip, [{:step, fun, i, state} | rest]}

      other ->
        throw_failure(i, :error, bad_return_error(other), [])
    end
  end

  def run_stateful([step | rest], data, message) do
    case apply_step(step, data, message) do
      {:emit, value} ->
        {out, rest} = run_stateful(rest, value, message)
        {out, [step | rest]}

      @skip ->
        {@skip, [step | rest]}
    end
  end

  @doc "Returns the marker for an empty result: the step emits nothing."
  defmacro skip, do: @skip

  defp apply_step({kind, fun, i}, data, message) do
    try do
      case kind do
        :map -> {:emit, fun.(data)}
        :map2 -> {:emit, fun.(data, message)}
        :filter -> if fun.(data), do: {:emit, data}, else: @skip
        :filter2 -> if fun.(data, message), do: {:emit, data}, else: @skip
        :each -> emit_data(fun.(data), data)
        :each2 -> emit_data(fun.(data, message), data)
      end
    catch
      kind, reason -> throw_failure(i, kind, reason, __STACKTRACE__)
    end
  end

  defp emit_data(_result, data), do: {:emit, data}

  defp throw_failure(index, kind, reason, stack),
    do: throw({:situ_step, index, kind, reason, stack})

  defp step_kind(kind, fun) when is_function(fun, 1), do: kind
  defp step_kind(:map, _fun), do: :map2
  defp step_kind(:filter, _fun), do: :filter2
  defp step_kind(:each, _fun), do: :each2

  defp bad_return_error(other) do
    ArgumentError.exception(
      "a step must return {:emit, data, state} or {:skip, state}, got: #{inspect(other, limit: 8)}"
    )
  end
end
