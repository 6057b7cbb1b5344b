defmodule Situ.Parallel.Processes do
  @moduledoc false
  # The component of parallel with `branches: :processes`. Each branch is a separate pipeline (Branch.Process), and the
  # pure ProcessBranches decides what to send to it.
  #
  # The number of messages with undecided outputs is limited: when it reaches @limit, the input is held. If nothing
  # arrives although no branch is working, the branches need more input (for a window or a filter). The input is then
  # released and the limit doubled.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: :any, required: true, doc: "A function of a stream, or of a key and a stream."],
      type: [type: :any, default: :any],
      form: [type: :any, required: true],
      split: [type: {:optional, {:fun, 1}}],
      with: [type: {:optional, {:fun, 1}}],
      termination: [type: :any, default: :never],
      missing: [type: :any, default: :drop],
      on_branch_error: [type: {:in, [:stop, :restart]}, default: :stop],
      branches: [type: {:in, [:processes]}, default: :processes],
      branch_policy: [type: {:optional, {:struct, Situ.Delivery}}]
    ]

  alias Situ.Parallel.{PendingOutputs, RunningBranches, Parts, ProcessBranches}
  alias Situ.Pipeline.Client

  @limit 256

  defstruct [:opts, :pool, :timing, branches: %{}, limit: @limit, held?: false, moved?: true]

  @impl true
  def init(opts) do
    opts = Map.new(opts)

    pool =
      ProcessBranches.new(
        form: opts.form,
        termination: opts.termination,
        missing: opts.missing,
        creator: opts[:with] || (& &1)
      )

    {:ok, %__MODULE__{opts: opts, pool: pool}}
  end

  @impl true
  def handle_start(context, state),
    do: {[], %{state | timing: Client.call!(context.pipeline, :timing)}}

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(_input, messages, context, state) do
    {orders, outputs, after_all} =
      Enum.reduce(messages, {[], [], state}, &push_message(&1, &2, context, state))

    orders = orders |> :lists.reverse() |> :lists.append()
    outputs = outputs |> :lists.reverse() |> :lists.append()
    hold_or_resume(outputs, carry_out_orders(after_all, orders))
  end

  # Nothing is sent until all messages are known to be valid.
  defp push_message(message, {orders, outputs, state}, context, before) do
    or_abandon(state, before, fn ->
      parts = Parts.split_parts(state.opts.form, state.opts[:split], message.data)
      at = {context.path, message.originating_time}

      begun =
        Enum.reduce(
          ProcessBranches.keys_without_branch(state.pool, parts),
          state,
          &start_branch(&2, &1, at, before)
        )

      {more, came, pool} =
        or_abandon(begun, before, fn ->
          ProcessBranches.push_message(begun.pool, message, parts)
        end)

      {[more | orders], [came | outputs], %{begun | pool: pool}}
    end)
  end

  @impl true
  def handle_info({:situ_branch, id, said}, _context, state) do
    {outputs, state} = drain_branch_messages(handle_branch_message(said, id, state))
    hold_or_resume(outputs, state)
  end

  def handle_info({:situ_branch_failed, error}, _context, _state), do: raise(error)

  def handle_info({:hold_ended, :in}, _context, %{held?: true} = state) do
    if state.moved? or
         RunningBranches.at_work?(state.branches, ProcessBranches.awaited_branches(state.pool)),
       do: {[{:hold, :in}], %{state | moved?: false}},
       else: {[], %{state | held?: false, limit: state.limit * 2}}
  end

  def handle_info(message, _context, state) do
    case RunningBranches.find_ended(message, state.branches) do
      {id, result} ->
        {outputs, state} = handle_branch_end(id, result, state)
        hold_or_resume(outputs, state)

      nil ->
        {[], state}
    end
  end

  # The outputs of parts that are still in the branches must be emitted before this operator ends.
  @impl true
  def handle_closed(_input, time, context, state) do
    {orders, pool} = ProcessBranches.close_input(state.pool, time)
    state = carry_out_orders(%{state | pool: pool}, orders)
    monitors = for {_, branch} <- state.branches, into: %{}, do: {branch.monitor, true}
    drain_branches(state, {context.pipeline, monitors}, nil, [])
  end

  @impl true
  def terminate(_reason, state) do
    RunningBranches.stop_new_branches(state.branches, %{})
  end

  @impl true
  def describe(%{pool: pool} = state) do
    failed = if pool.failed > 0, do: ", #{pool.failed} failed and restarted", else: ""
    waiting = PendingOutputs.waiting_count(pool.entries)
    waits = if waiting > 0, do: ", #{waiting} messages wait", else: ""
    ending = map_size(state.branches) - map_size(pool.keys)
    ends = if ending > 0, do: ", #{ending} ending", else: ""

    "#{map_size(pool.keys)} branches live, each its own pipeline, #{pool.started} started#{ends}#{failed}#{waits}"
  end

  @doc "Returns the pipelines of the branches."
  @spec branch_pipelines(term()) :: [pid()]
  def branch_pipelines(%__MODULE__{branches: branches}),
    do: for({_, branch} <- branches, do: branch.pid)

  defp start_branch(state, key, {path, time}, before) do
    id = make_ref()
    timing = Map.merge(state.timing, %{start: time, policy: state.opts[:branch_policy]})
    at = {Situ.Branch.Path.to_string({path, key}), state.opts.type, timing}
    fun = bind_key(state.opts.fun, key)

    running =
      or_abandon(state, before, fn ->
        RunningBranches.start_branch(state.branches, id, fun, at)
      end)

    pool = ProcessBranches.put_branch(state.pool, key, id, running[id].output?)
    %{state | pool: pool, branches: running}
  end

  # If a message fails, the branches that were started for it are stopped.
  defp or_abandon(state, before, fun) do
    fun.()
  rescue
    error ->
      RunningBranches.stop_new_branches(state.branches, before.branches)
      reraise error, __STACKTRACE__
  end

  defp bind_key(fun, _key) when is_function(fun, 1), do: fun
  defp bind_key(fun, key), do: &fun.(key, &1)

  defp carry_out_orders(state, orders),
    do: %{state | branches: RunningBranches.carry_out(orders, state.branches)}

  # Handles all branch messages that are already in the mailbox, in one time slice.
  defp drain_branch_messages({outputs, state}) do
    receive do
      {:situ_branch, id, said} ->
        {more, state} = handle_branch_message(said, id, state)
        drain_branch_messages({outputs ++ more, state})
    after
      0 -> {outputs, state}
    end
  end

  defp handle_branch_message({:open, gate}, id, state) when is_map_key(state.branches, id),
    do: {[], %{state | branches: RunningBranches.put_gate(state.branches, id, gate)}}

  defp handle_branch_message({:outputs, reported, passed_time}, id, %{branches: branches} = state) do
    passed_time = if match?(%{^id => %{immediate?: true}}, branches), do: passed_time
    {outputs, pool} = ProcessBranches.add_outputs(state.pool, id, reported, passed_time)
    {outputs, %{state | pool: pool, moved?: true}}
  end

  defp handle_branch_message(_of_a_branch_that_is_gone, _id, state), do: {[], state}

  # A branch has ended, either as requested or because it failed.
  defp handle_branch_end(id, result, state) do
    {outputs, pool} = ProcessBranches.remove_branch(state.pool, id)

    state = %{
      state
      | branches: RunningBranches.remove_branch(state.branches, id),
        pool: pool,
        moved?: true
    }

    {outputs, handle_branch_result(result, state)}
  end

  defp handle_branch_result({:ok, _report}, state), do: state

  defp handle_branch_result({:error, _error}, %{opts: %{on_branch_error: :restart}} = state),
    do: put_in(state.pool.failed, state.pool.failed + 1)

  # The error is raised with the next message, so that the state without the branch is kept for any `on_error:`.
  defp handle_branch_result({:error, error}, state) do
    send(self(), {:situ_branch_failed, error})
    state
  end

  defp hold_or_resume(outputs, state) do
    waiting = PendingOutputs.waiting_count(state.pool.entries)

    cond do
      not state.held? and waiting >= state.limit ->
        {outputs ++ [{:hold, :in}], %{state | held?: true, moved?: false}}

      state.held? and waiting <= div(state.limit, 2) ->
        {outputs ++ [{:resume, :in}], %{state | held?: false}}

      true ->
        {outputs, state}
    end
  end

  # Waits until every branch has ended, however long the branches take for their remaining messages. It keeps reporting
  # progress to the surrounding pipeline.
  defp drain_branches(%{branches: branches} = state, _around, _marks, outputs)
       when map_size(branches) == 0,
       do: finish_drain(state, outputs)

  defp drain_branches(state, {pipeline, monitors} = around, marks, outputs) do
    receive do
      {:situ_branch, id, said} ->
        {more, state} = handle_branch_message(said, id, state)
        Client.report_movement(pipeline)
        drain_branches(state, around, marks, [more | outputs])

      {id, result} when is_map_key(state.branches, id) ->
        {more, state} = handle_branch_end(id, result, state)
        drain_branches(state, around, marks, [more | outputs])

      {:DOWN, monitor, :process, _, _} = down when is_map_key(monitors, monitor) ->
        {id, result} = RunningBranches.find_ended(down, state.branches)
        {more, state} = handle_branch_end(id, result, state)
        drain_branches(state, around, marks, [more | outputs])
    after
      1_000 ->
        now = RunningBranches.progress_marks(state.branches)
        if now != marks, do: Client.report_movement(pipeline)
        drain_branches(state, around, now, outputs)
    end
  end

  defp finish_drain(state, outputs) do
    receive do
      {:situ_branch_failed, error} -> raise error
    after
      0 -> {outputs |> Enum.reverse() |> Enum.concat(), state}
    end
  end
end
