defmodule Situ.Parallel.Values do
  @moduledoc false
  # Branches that are values in the operator's process (`Situ.Branch`). Every part is handled immediately.
  @behaviour Situ.Parallel.Strategy
  alias Situ.Branch
  alias Situ.Branch.Chain

  @enforce_keys [:fun, :context, :seed]
  defstruct [:fun, :context, :seed, :template]

  @impl true
  def build_state(opts, context),
    do: %__MODULE__{fun: opts.fun, context: context, seed: Branch.build_seed(opts.type)}

  @impl true
  def start_branch(state, key, _time) do
    opts = [seed: state.seed, path: branch_path(state, key), context: state.context]
    {branch, template} = Branch.start_like(bind_key(state.fun, key), state.template, opts)
    {branch, Branch.has_output?(branch), %{state | template: template}}
  end

  defp branch_path(state, key), do: {state.context.path, key}

  defp bind_key(fun, _key) when is_function(fun, 1), do: fun
  defp bind_key(fun, key), do: &fun.(key, &1)

  @impl true
  def push_part(state, key, %Chain{} = branch, data, message) do
    Chain.push_data(branch, data, message)
  catch
    {:situ_step, _, _, _, _} = failure ->
      Chain.raise_failure(branch, Branch.format_path(branch_path(state, key)), failure)
  end

  def push_part(_state, _key, branch, data, message) do
    {outputs, branch} = Branch.push(branch, %{message | data: data})
    {:outputs, outputs, branch}
  end

  @impl true
  def pass_time(state, _branch, _time), do: state

  @impl true
  def close_branch(_state, _key, branch, time), do: {:closed, Branch.close(branch, time)}

  @impl true
  def immediate?(branch), do: is_struct(branch, Chain)

  @impl true
  def waiting_limit, do: :infinity

  @impl true
  def send_parts(state), do: state

  @impl true
  def read_event(_state, _message), do: nil

  @impl true
  def await_event(_state, _timeout), do: nil

  @impl true
  def list_pipelines(_state), do: []

  @impl true
  def snapshot_branch(state, key, branch),
    do: Branch.take_snapshot(branch, Branch.format_path(branch_path(state, key)))

  @impl true
  def restore_branch(state, key, plain, branch),
    do: Branch.restore_snapshot(branch, plain, Branch.format_path(branch_path(state, key)))
end
