defmodule Situ.Parallel.Processes do
  @moduledoc false
  # Branches that are separate pipelines with their own processes (`Situ.Parallel.BranchPipeline`), and so may contain
  # any component. With `choose_node:`, the pipeline of a key runs on the node that the function returns.
  #
  # The parts of a batch are collected, and sent in one message for each branch. Parts for a branch that has not opened
  # its input yet are kept until it has.
  @behaviour Situ.Parallel.Strategy
  alias Situ.Lifecycle.Errors
  alias Situ.Parallel.{BranchPipeline, Relay}
  alias Situ.Pipeline.Client

  @enforce_keys [:opts, :path, :timing]
  defstruct [:opts, :path, :timing, branches: %{}, unsent: %{}, closing: []]

  # The branch of a key is represented by a reference.
  @typep branch :: %{
           key: term(),
           pid: pid(),
           gate: pid() | nil,
           output?: boolean(),
           immediate?: boolean(),
           early: [BranchPipeline.entry()],
           last_time: Situ.Time.t() | nil,
           stop: Situ.Time.t() | nil
         }
  @type t :: %__MODULE__{branches: %{reference() => branch()}}

  @impl true
  def build_state(opts, context) do
    timing = Map.put(Client.call!(context.pipeline, :timing), :policy, opts[:branch_policy])
    %__MODULE__{opts: opts, path: context.path, timing: timing}
  end

  @impl true
  def start_branch(%{opts: opts} = state, key, time) do
    id = make_ref()
    fun = if is_function(opts.fun, 1), do: opts.fun, else: &opts.fun.(key, &1)
    node = if opts[:choose_node], do: opts.choose_node.(key), else: node()
    timing = Map.put(state.timing, :start, time)
    place = %{id: id, node: node, path: format_path(state, key), type: opts.type, timing: timing}
    built = start_pipeline(fun, place)
    # The messages of a lost branch are known by the tag, without a search for the monitor.
    :erlang.monitor(:process, built.pid, tag: {:situ_branch_down, id})
    branch = Map.merge(built, %{key: key, gate: nil, early: [], last_time: nil, stop: nil})
    {id, built.output?, put_branch(state, id, branch)}
  end

  defp start_pipeline(fun, %{node: node} = place) when node == node(),
    do: BranchPipeline.start!(fun, place)

  defp start_pipeline(fun, place), do: Relay.start!(fun, place)

  defp format_path(state, key), do: Situ.Branch.format_path({state.path, key})
  defp put_branch(state, id, branch), do: %{state | branches: Map.put(state.branches, id, branch)}

  @impl true
  def push_part(state, _key, id, data, message),
    do: {:sent, add_entry(state, id, {message.originating_time, data})}

  # Only chains of light operators report the times they have passed.
  @impl true
  def pass_time(state, id, time),
    do: if(state.branches[id].immediate?, do: add_entry(state, id, time), else: state)

  defp add_entry(%{unsent: unsent} = state, id, entry) do
    case unsent do
      %{^id => entries} -> %{state | unsent: %{unsent | id => [entry | entries]}}
      _ -> %{state | unsent: Map.put(unsent, id, [entry])}
    end
  end

  @impl true
  def close_branch(state, _key, id, time),
    do: {:later, %{state | closing: [{id, time} | state.closing]}}

  @impl true
  def immediate?(_id), do: false

  @impl true
  def waiting_limit, do: 256

  @impl true
  def send_parts(%{unsent: unsent, closing: closing} = state) do
    state = Enum.reduce(unsent, %{state | unsent: %{}, closing: []}, &send_entries/2)
    Enum.reduce(closing, state, &request_stop/2)
  end

  # Entries are newest first. Only a function may name an earlier end than the last part of a branch.
  defp send_entries({id, [newest | _] = entries}, %{opts: opts} = state) do
    branch = Map.fetch!(state.branches, id)
    if branch.gate, do: send(branch.gate, {:situ_feed, :lists.reverse(entries)})

    if branch.gate && not is_function(opts.termination.rule) do
      state
    else
      early = if branch.gate, do: [], else: entries ++ branch.early
      put_branch(state, id, %{branch | early: early, last_time: entry_time(newest)})
    end
  end

  defp entry_time({time, _data}), do: time
  defp entry_time(time), do: time

  # A branch ends after the last message sent to it, even if its rule names an earlier time.
  defp request_stop({id, time}, state) do
    branch = Map.fetch!(state.branches, id)
    time = if branch.last_time, do: max(time, branch.last_time), else: time
    if branch.gate, do: send(branch.pid, {:situ_stop, time})
    put_branch(state, id, %{branch | stop: time})
  end

  @impl true
  def read_event(state, {:situ_branch, id, content}), do: read_content(state, id, content)

  def read_event(%{branches: branches} = state, {id, result}) when is_map_key(branches, id),
    do: end_branch(state, id, if(match?({:ok, _report}, result), do: :ok, else: result))

  def read_event(state, {{:situ_branch_down, id}, _monitor, :process, _pid, reason}) do
    case state.branches do
      %{^id => %{key: key}} ->
        what = "#{format_path(state, key)} was killed: #{inspect(reason, limit: 8)}"
        error = %{Errors.pipeline_crashed(reason) | code: :branch_killed, what: what}
        end_branch(state, id, {:error, error})

      _ended ->
        {:other, state}
    end
  end

  def read_event(_state, _message), do: nil

  defp read_content(%{branches: branches} = state, id, content) do
    case {content, branches} do
      {{:outputs, outputs, passed_time}, %{^id => branch}} ->
        passed_time = if branch.immediate?, do: passed_time
        {{:outputs, id, outputs, passed_time}, state}

      {{:open, gate, _pipeline}, %{^id => branch}} ->
        if branch.early != [], do: send(gate, {:situ_feed, :lists.reverse(branch.early)})
        if branch.stop, do: send(branch.pid, {:situ_stop, branch.stop})
        {:other, put_branch(state, id, %{branch | gate: gate, early: []})}

      # The message that started this branch has failed.
      {{:open, _gate, pipeline}, _unknown} ->
        send(pipeline, :situ_stop)
        {:other, state}

      _ ->
        {:other, state}
    end
  end

  defp end_branch(state, id, result) do
    {branch, branches} = Map.pop!(state.branches, id)
    {{:ended, branch.key, id, result}, %{state | branches: branches}}
  end

  @impl true
  def await_event(%{branches: branches} = state, timeout) do
    receive do
      {:situ_branch, _id, _content} = message -> read_event(state, message)
      {id, _result} = message when is_map_key(branches, id) -> read_event(state, message)
      {{:situ_branch_down, _id}, _, _, _, _} = message -> read_event(state, message)
    after
      timeout -> nil
    end
  end

  @impl true
  def list_pipelines(state),
    do: for({id, branch} <- state.branches, do: {id, branch.pid, branch.immediate?})

  # A checkpoint names the reference as the reason for which it cannot save the operator.
  @impl true
  def snapshot_branch(_state, _key, id), do: {:ok, id}

  @impl true
  def restore_branch(_state, _key, _plain, id), do: {:ok, id}
end
