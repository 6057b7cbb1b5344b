defmodule Situ.Parallel.Processes do
  @moduledoc false
  # The component behind parallel with `branches: :processes`: each branch is a pipeline of its own (Branch.Process), told what to do by the
  # pure Pool.
  #
  # Messages whose outputs are not decided are bounded: from @limit on, the input is held. It is let go, and the limit doubled, when nothing
  # comes any more although no branch is at work: they wait for more input then (a window, a filter).
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      fun: [type: :any, required: true, doc: "of a stream, or of a key and a stream"],
      type: [type: :any, default: :any],
      form: [type: :any, required: true],
      split: [type: {:optional, {:fun, 1}}],
      with: [type: {:optional, {:fun, 1}}],
      termination: [type: :any, default: :never],
      missing: [type: :any, default: :drop],
      on_branch_error: [type: {:in, [:stop, :restart]}, default: :stop]
    ]

  alias Situ.Branch.Process, as: Branch
  alias Situ.Parallel.{Entries, Parts, Pool}
  alias Situ.Pipeline.{Ask, Launch}

  @limit 256

  defstruct [:opts, :pool, :timing, branches: %{}, limit: @limit, held: false, moved: true]

  @impl true
  def init(opts) do
    opts = Map.new(opts)

    pool =
      Pool.new(
        form: opts.form,
        termination: opts.termination,
        missing: opts.missing,
        creator: opts[:with] || (& &1)
      )

    {:ok, %__MODULE__{opts: opts, pool: pool}}
  end

  @impl true
  def handle_start(context, state),
    do: {[], %{state | timing: Ask.call!(context.pipeline, :timing)}}

  @impl true
  def handle_message(_input, message, context, state) do
    parts = Parts.of(state.opts.form, state.opts[:split], message.data)
    at = {context.path, message.originating_time}
    begun = Enum.reduce(Pool.unknown(state.pool, parts), state, &begin(&2, &1, at, state))

    {orders, outputs, pool} =
      or_abandon(begun, state, fn -> Pool.push(begun.pool, message, parts) end)

    balance(outputs, Enum.reduce(orders, %{begun | pool: pool}, &carry_out/2))
  end

  @impl true
  def handle_info({:situ_branch, id, said}, _context, state) do
    {outputs, state} = said(said, id, state)
    balance(outputs, state)
  end

  def handle_info({:situ_branch_failed, error}, _context, _state), do: raise(error)

  def handle_info({:hold_ended, :in}, _context, %{held: true} = state) do
    if state.moved or at_work?(state),
      do: {[{:hold, :in}], %{state | moved: false}},
      else: {[], %{state | held: false, limit: state.limit * 2}}
  end

  def handle_info({id, result}, _context, state) when is_map_key(state.branches, id) do
    {outputs, state} = over(id, result, state)
    balance(outputs, state)
  end

  def handle_info({:DOWN, _monitor, :process, pid, reason}, _context, state) do
    case Enum.find(state.branches, fn {_, branch} -> branch.pid == pid end) do
      {id, _} ->
        {outputs, state} = over(id, {:error, killed(state, id, reason)}, state)
        balance(outputs, state)

      nil ->
        {[], state}
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  # The outputs of what is still in the branches come before this one's end.
  @impl true
  def handle_closed(_input, time, _context, state) do
    {orders, pool} = Pool.close(state.pool, time)
    drain(Enum.reduce(orders, %{state | pool: pool}, &carry_out/2), [])
  end

  @impl true
  def terminate(_reason, state) do
    for {_, branch} <- state.branches, do: send(branch.pid, :situ_stop)
    :ok
  end

  @impl true
  def describe(%{pool: pool} = state) do
    failed = if pool.failed > 0, do: ", #{pool.failed} failed and begun anew", else: ""
    waiting = Entries.size(pool.entries)
    waits = if waiting > 0, do: ", #{waiting} messages wait", else: ""
    ending = map_size(state.branches) - map_size(pool.keys)
    ends = if ending > 0, do: ", #{ending} ending", else: ""

    "#{map_size(pool.keys)} branches live, each a pipeline of its own, #{pool.started} started#{ends}#{failed}#{waits}"
  end

  @doc "The pipelines of the branches."
  @spec pipelines(term()) :: [pid()]
  def pipelines(%__MODULE__{branches: branches}), do: for({_, branch} <- branches, do: branch.pid)

  # Branches

  defp begin(state, key, {path, time}, before) do
    id = make_ref()
    path = Situ.Branch.path({path, key})
    timing = Map.put(state.timing, :start, time)

    built =
      or_abandon(state, before, fn ->
        Branch.start!(of_key(state.opts.fun, key), id, path, state.opts.type, timing)
      end)

    monitor = Process.monitor(built.pid)
    shell = %{monitor: monitor, path: path, gate: nil, early: [], stop: nil}
    pool = Pool.started(state.pool, key, id, built.output?)
    %{state | pool: pool, branches: Map.put(state.branches, id, Map.merge(built, shell))}
  end

  # A message that fails takes the branches with it that were begun for it.
  defp or_abandon(state, before, fun) do
    fun.()
  rescue
    error ->
      for {id, branch} <- state.branches, not is_map_key(before.branches, id) do
        Process.demonitor(branch.monitor, [:flush])
        send(branch.pid, :situ_stop)
      end

      reraise error, __STACKTRACE__
  end

  defp of_key(fun, _key) when is_function(fun, 1), do: fun
  defp of_key(fun, key), do: &fun.(key, &1)

  defp carry_out({:stop, id, time}, state) do
    case Map.fetch!(state.branches, id) do
      %{gate: nil} = branch ->
        put_in(state.branches[id], %{branch | stop: time})

      branch ->
        Branch.stop(branch.pid, time)
        state
    end
  end

  defp carry_out({:pass, id, time}, state) do
    if state.branches[id].immediate?, do: feed(state, id, time), else: state
  end

  defp carry_out({:feed, id, message}, state), do: feed(state, id, message)

  defp feed(state, id, entry) do
    case Map.fetch!(state.branches, id) do
      %{gate: nil} = branch ->
        put_in(state.branches[id], %{branch | early: [entry | branch.early]})

      %{gate: gate} ->
        Branch.feed(gate, entry)
        state
    end
  end

  defp said({:open, gate}, id, state) when is_map_key(state.branches, id) do
    branch = Map.fetch!(state.branches, id)
    for entry <- Enum.reverse(branch.early), do: Branch.feed(gate, entry)
    if branch.stop, do: Branch.stop(branch.pid, branch.stop)
    {[], put_in(state.branches[id], %{branch | gate: gate, early: []})}
  end

  defp said({:gave, time, value}, id, state) do
    {outputs, pool} = Pool.gave(state.pool, id, time, value)
    {outputs, %{state | pool: pool, moved: true}}
  end

  defp said({:passed, time}, id, %{branches: branches} = state) do
    case branches do
      %{^id => %{immediate?: true}} ->
        {outputs, pool} = Pool.passed(state.pool, id, time)
        {outputs, %{state | pool: pool, moved: true}}

      _ ->
        {[], state}
    end
  end

  defp said(_of_a_branch_that_is_gone, _id, state), do: {[], state}

  # A branch has ended: as it was told to, or by a failure.
  defp over(id, result, state) do
    {branch, branches} = Map.pop!(state.branches, id)
    Process.demonitor(branch.monitor, [:flush])
    {outputs, pool} = Pool.ended(state.pool, id)
    {outputs, failed(result, %{state | branches: branches, pool: pool, moved: true})}
  end

  defp failed({:ok, _report}, state), do: state

  defp failed({:error, _error}, %{opts: %{on_branch_error: :restart}} = state),
    do: put_in(state.pool.failed, state.pool.failed + 1)

  # Raised with the next message, so that the state without the branch is kept whatever `on_error` says.
  defp failed({:error, error}, state) do
    send(self(), {:situ_branch_failed, error})
    state
  end

  defp killed(state, id, reason) do
    path = state.branches[id].path

    %{
      Launch.crashed(reason)
      | code: :branch_killed,
        what: "#{path} was killed: #{inspect(reason, limit: 8)}"
    }
  end

  # Holding back

  defp balance(outputs, state) do
    waiting = Entries.size(state.pool.entries)

    cond do
      not state.held and waiting >= state.limit ->
        {outputs ++ [{:hold, :in}], %{state | held: true, moved: false}}

      state.held and waiting <= div(state.limit, 2) ->
        {outputs ++ [{:resume, :in}], %{state | held: false}}

      true ->
        {outputs, state}
    end
  end

  # A run of light operators tells when it is through; others are asked.
  defp at_work?(state) do
    Enum.any?(Pool.awaited(state.pool), fn id ->
      branch = Map.fetch!(state.branches, id)
      branch.immediate? or Ask.call(branch.pid, :quiet?) != true
    end)
  end

  defp drain(%{branches: branches} = state, outputs) when map_size(branches) == 0,
    do: drained(state, outputs)

  defp drain(state, outputs) do
    receive do
      {:situ_branch, id, said} ->
        {more, state} = said(said, id, state)
        drain(state, [more | outputs])

      {id, result} when is_map_key(state.branches, id) ->
        {more, state} = over(id, result, state)
        drain(state, [more | outputs])

      {:DOWN, _, :process, pid, reason} ->
        case Enum.find(state.branches, fn {_, branch} -> branch.pid == pid end) do
          {id, _} ->
            {more, state} = over(id, {:error, killed(state, id, reason)}, state)
            drain(state, [more | outputs])

          nil ->
            drain(state, outputs)
        end
    end
  end

  defp drained(state, outputs) do
    receive do
      {:situ_branch_failed, error} -> raise error
    after
      0 -> {outputs |> Enum.reverse() |> Enum.concat(), state}
    end
  end
end
