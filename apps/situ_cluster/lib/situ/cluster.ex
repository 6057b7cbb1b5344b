defmodule Situ.Cluster do
  @moduledoc """
  Runs one pipeline on several nodes, and keeps it running when a node is lost.

      # on every node (or in its supervision tree: {Situ.Cluster, log: ..., labels: [...]})
      {:ok, _} = Situ.Cluster.start_link(log: "/var/lib/situ/log", labels: ["camera"])

      # on any of these nodes
      {:ok, deployment} =
        Situ.Cluster.deploy(Lobby,
          place: [{"Lips", on: "camera"}, {"Recording", on: :"situ@store.local"}],
          checkpoint: Situ.Time.s(1)
        )

  Nodes are connected by Erlang distribution (`Node.connect/1`), and share one durable log of messages, leases and
  checkpoints.

  ## Parts

  The rules of `place:` split the graph into parts. A rule names a component or a composite and takes everything below
  it; all other components belong to the part `"rest"`. A part runs on one node as a separate pipeline. Streams
  between parts are GenStage edges with the same back-pressure, from a part's publisher to the parts that read it.
  They are also written to the log, for takeover. A stream bypasses the log if all of its readers use a lossy policy,
  or if `direct:` names it.

  If a part waits, through other parts, for its own outputs, its sources become a separate part (`"rest sources"`),
  which is placed by the same rule.

  Every node must have the module and builds the same graph: `build/2` is called on each node with the same options.

  ## When a node is lost

  Each part has a lease in the log, which depends on a lease of its node. The node renews it every quarter of `lease:`,
  for all of its parts together. When the renewals stop, or earlier when Erlang reports the node down, another node
  takes the part over. It fences the part's streams, so that
  the old node can no longer write even if it is still alive, starts the part from its last checkpoint and reads its
  inputs from that position. Values and originating times are the same as without the loss:

    * By default, the outputs of a part become visible only when a checkpoint contains them (the outbox). This is
      correct for every part, but the outputs appear only every `checkpoint:`.
    * The outputs of a part declared `deterministic: true` are visible immediately. When the part is restarted, it
      produces the same outputs again, and those already published are skipped. Its outputs must depend only on the
      values and originating times of its inputs: use reproducible operators, no clock and no randomness.

  A component whose state is not plain data needs `c:Situ.Component.snapshot/1` and `c:Situ.Component.restore/2`. A
  deterministic part with a component that lacks them is restarted from the first message of its inputs. Any other
  such part that has readers is rejected, with an error that names the component.

  Sources on a lost device are lost with it: the cluster does not invent data that no device recorded.

  ## The log

  | `log:` of `start_link/1` | for |
  |---|---|
  | a folder | the nodes of one machine; network file systems do not support it reliably |
  | `"nats://host:port,host:port"` | several machines and sites: NATS JetStream (`nats-server -js`), 2.9 or newer |

  If the NATS server is lost, the nodes try the servers of the list in turn, and continue when they are connected again.
  The address may contain `user:password@` or `token@`, but a file (`credentials:`) is safer. A stream costs its server
  two open files and about 80 KB of memory, so raise the server's limit of open files (`LimitNOFILE`) before you log
  several thousand streams. `Situ.Cluster.Identity` creates certificates and a password for the nodes and the server.

  `log_options:` of a folder:

  #{Situ.Options.docs(Situ.Cluster.Log.Folder.options())}

  `log_options:` of NATS:

  #{Situ.Options.docs(Situ.Cluster.Log.Nats.options())}

  ## Limits

  When a node is lost, messages in flight on a direct stream are lost. A recording that is taken over continues in a
  copy if the new node can read the previous one, and otherwise at the checkpoint, with a warning. A recording in
  segments cannot be carried over: its part is restarted from the first message of the log, writes a new version,
  and fails if `retain:` has deleted that message. `Situ.Pipeline.on/4` handlers run with the part `"rest"` and with
  parts that record; the handlers of a resource (a recording, a link) run with the parts that use it. The log of a
  finished deployment remains until `prune/2` deletes it. An upgrade cannot change the graph.

  The log also contains the deployments. If all nodes were lost, they run the deployments again when they are back,
  except deployments that ended or were forgotten. The log's entries are sealed with the cluster's cookie. An entry
  that was written, changed or moved by anybody else is never used as data, and the part that reads it fails with the
  reason.
  """
  alias Situ.Cluster.{
    Agent,
    PartStarter,
    LoadBalance,
    Balancer,
    Completion,
    StreamEntry,
    Deployment,
    LogLines,
    Member,
    Overview
  }

  alias Situ.Cluster.{Deployments, Retention, Placement, Plan, Recordings, Runner, Runners}
  alias Situ.Cluster.{SealedLog, Upgrade, NodeMetrics, SnapshotMerge}
  alias Situ.{Error, Options, Pipeline}
  alias Situ.Cluster.Log

  @schema [
    log: [type: :string, required: true, doc: "The address of the log."],
    log_options: [
      type: :keyword,
      default: [],
      doc: "Options of the log (see *The log* in `Situ.Cluster`)."
    ],
    labels: [
      type: {:list, :string},
      default: [],
      doc: "Labels of this node, for the rules of `place:`."
    ],
    devices: [
      type: {:list, :string},
      default: [],
      doc:
        "The devices connected to this node, by the names that rules `on: {:near, device}` use."
    ],
    recordings: [
      type: {:optional, :string},
      default: nil,
      doc:
        "A folder with recordings. `overview/0` lists the newest 200 of each node, and the studio's cluster page" <>
          " opens them over a link that this node serves. Anybody who can call functions on the node can read them."
    ]
  ]

  # A node may be busy, so it gets this long to reply.
  @answer_ms 5_000

  @typedoc "The result of `deploy/2`, which is valid on every node."
  @type t :: Deployment.t()

  @doc "Returns a child specification, for `{Situ.Cluster, log: address, labels: [...]}` in a supervision tree."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(opts), do: %{id: __MODULE__, start: {__MODULE__, :start_link, [opts]}}

  @doc """
  Makes this node a member of the cluster. If a NATS server is not running yet, logs the reason and waits for it.

  #{Options.docs(@schema)}
  """
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, log} <- connect_log(opts[:log], opts[:log_options]),
         do:
           Agent.start_link(
             log: log,
             labels: opts[:labels],
             devices: opts[:devices],
             companions: [{Balancer, &balance/1}, {Recordings, opts[:recordings]}]
           )
  end

  @doc "Does the same as `start_link/1`, but the member does not end with its caller; for shells and scripts."
  @spec join(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def join(opts) do
    with {:ok, agent} <- start_link(opts) do
      Process.unlink(agent)
      {:ok, agent}
    end
  end

  # The node waits for a server that is not running yet, as for a lost server.
  defp connect_log("nats://" <> _ = address, opts), do: Log.connect(address, [wait: true] ++ opts)
  defp connect_log(address, opts), do: Log.connect(address, opts)

  @doc """
  Runs a pipeline on the cluster.

  #{Options.docs(Deployment.schema())}

  Rules of `place:`

  #{Options.docs(Deployment.place_schema())}
  """
  @spec deploy(module(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def deploy(module, opts \\ []) do
    with {:ok, deployment} <- Deployment.new(module, opts),
         :ok <- check_member(),
         do: Agent.deploy(deployment)
  end

  defp check_member do
    if Process.whereis(Agent), do: :ok, else: {:error, Member.not_member_error()}
  end

  @doc """
  Waits until all parts have ended. Returns `{:error, error}` when a part has failed, or after `timeout` ms
  (`:timeout`).
  """
  @spec await(t(), timeout()) :: :ok | {:error, Error.t()}
  def await(%Deployment{} = deployment, timeout \\ :infinity) do
    with {:ok, plan} <- PartStarter.build_plan(deployment) do
      deadline = if timeout == :infinity, do: :infinity, else: monotonic_ms() + timeout

      Completion.await_parts(
        deployment_log(deployment),
        deployment,
        Map.keys(plan.parts),
        deadline
      )
    end
  end

  defp deployment_log(%Deployment{run: run}), do: SealedLog.new(Agent.get_log(), run || "")

  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  @doc "Returns the messages of a stream in the log: a stream that crosses from part to part, or is in `publish:`."
  @spec read(t(), String.t()) :: {:ok, [Situ.Message.t()]} | {:error, Error.t()}
  def read(%Deployment{} = deployment, stream),
    do: read_entries(deployment_log(deployment), {:stream, "#{deployment.name}.#{stream}"}, 1, [])

  defp read_entries(log, subject, from, lists) do
    case Log.read(log, subject, from, 64) do
      {:ok, []} ->
        {:ok, lists |> Enum.reverse() |> Enum.concat()}

      {:ok, entries} ->
        with {:ok, messages} <- decode_entries(entries, []),
             do: read_entries(log, subject, List.last(entries).seq + 1, [messages | lists])

      error ->
        error
    end
  end

  defp decode_entries([], lists), do: {:ok, lists |> Enum.reverse() |> Enum.concat()}

  defp decode_entries([entry | rest], lists) do
    with {:ok, messages} <- StreamEntry.decode_messages(entry),
         do: decode_entries(rest, [messages | lists])
  end

  @doc """
  Stops the sources of a deployment; its parts then handle the messages already posted. Does not wait: see `await/2`.
  """
  @spec stop(t()) :: :ok
  def stop(%Deployment{} = deployment) do
    for {_node, runners} <- runners_by_node(deployment),
        {_, runner} <- runners,
        do: Runner.stop_sources(runner)

    :ok
  end

  @doc "Removes a deployment from all nodes immediately; its log remains."
  @spec forget(t()) :: :ok | {:error, Error.t()}
  def forget(%Deployment{name: name}), do: Agent.forget_deployment(name)

  @doc """
  Lists how much the cluster's log contains of each deployment, including deployments that have ended: the name of
  the `deployment`, the number of its `streams` and `entries`, their size in `bytes`, and when the last one was
  `written` (ns since 1970, or `nil`).
  """
  @spec list_log_usage() :: {:ok, [Retention.t()]} | {:error, Error.t()}
  def list_log_usage, do: with(:ok <- check_member(), do: Retention.list(Agent.get_log()))

  @doc """
  Permanently deletes the log of a deployment that has ended (which is then also forgotten) or was forgotten.

  Refuses a deployment that is running (`:in_use`), even on another cluster that uses the same log: the function
  watches the leases for `wait` ms, or for half of that deployment's `lease:` if that is longer. Returns the number
  of deleted subjects (streams and keys).
  """
  @spec prune(String.t(), non_neg_integer()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def prune(name, wait \\ 1_500) when is_binary(name) do
    with {:ok, all} <- list_log_usage(),
         {:ok, usage} <- Retention.fetch_by_name(all, name),
         {:ok, tries} <- forget_if_ended(Enum.find(Agent.info().deployments, &(&1.name == name))),
         :ok <- await_unused(usage, wait, tries),
         {:ok, deleted} <- Retention.delete(Agent.get_log(), usage),
         :ok <- Deployments.delete(Agent.get_log(), name),
         do: {:ok, deleted}
  end

  # Other nodes may renew a lease once more before they learn that the deployment was forgotten.
  defp await_unused(usage, wait, tries) do
    with {:error, %{code: :in_use}} when tries > 1 <-
           Retention.check_unused(Agent.get_log(), usage, wait),
         do: await_unused(usage, wait, tries - 1)
  end

  # Returns how many times to watch the leases.
  defp forget_if_ended(nil), do: {:ok, 1}

  defp forget_if_ended(deployment) do
    case await(deployment, 0) do
      {:error, %{code: :timeout}} -> {:error, Retention.in_use_error(deployment.name)}
      _ended_or_failed -> with :ok <- forget(deployment), do: {:ok, 3}
    end
  end

  @doc """
  Returns the members with their labels, and the state of every part: its node, its phase (`:running`, `:done`,
  `:failed`, or `:standby` when no node runs it), the epoch of its lease, its checkpoints, and its streams with their
  counts.
  """
  @spec status(t()) :: %{members: map(), parts: %{String.t() => map()}}
  def status(%Deployment{} = deployment) do
    targets =
      for {node, runners} <- runners_by_node(deployment),
          {part, runner} <- runners,
          do: {part, node, runner}

    answers = targets |> Enum.map(&elem(&1, 2)) |> Runners.collect_infos(@answer_ms)
    infos = Enum.zip_with(targets, answers, fn {part, node, _}, info -> {part, node, info} end)

    parts =
      for {part, entries} <- Enum.group_by(infos, &elem(&1, 0)), into: %{} do
        owner =
          Enum.find(entries, fn {_, _, info} -> info[:phase] in [:running, :done, :failed] end)

        {part, part_status(owner)}
      end

    %{members: Agent.info().members, parts: parts}
  end

  defp runner_info(runner) do
    Runner.part_info(runner)
  catch
    :exit, _ -> %{}
  end

  defp part_status(nil), do: %{phase: :standby, node: nil}
  defp part_status({_, node, info}), do: Map.put(info, :node, node)

  @doc """
  Moves a part to another node without losing a message: the part takes a checkpoint, then the other node takes it
  over. Returns `{:error, error}` if the node is not a member.
  """
  @spec move(t(), String.t(), node()) :: :ok | {:error, Error.t()}
  def move(%Deployment{} = deployment, part, to) do
    runners =
      for {node, %{^part => runner}} <- runners_by_node(deployment), into: %{}, do: {node, runner}

    case Map.pop(runners, to) do
      {nil, _} ->
        {:error,
         Error.new(:no_such_part, "#{to} has no part #{inspect(part)} of #{deployment.name}",
           fix: "see Situ.Cluster.status/1 for members and parts"
         )}

      {runner, others} ->
        demotions = for {_, other} <- others, do: {other, demotion_level(other)}
        # This also overrides an earlier drain of the target node.
        :ok = Runner.set_demotion(runner, 0)
        for {other, demotion} <- demotions, do: Runner.release_part(other, demotion + 1, self())
        answer = await_takeover(deployment, part, to, monotonic_ms() + 60_000)
        for {other, demotion} <- demotions, do: Runner.set_demotion(other, demotion)
        answer
    end
  end

  defp demotion_level(runner), do: Map.get(runner_info(runner), :demotion, 0)

  defp await_takeover(deployment, part, to, deadline) do
    case status(deployment).parts do
      %{^part => %{node: ^to}} ->
        :ok

      _ ->
        if monotonic_ms() > deadline do
          {:error, Error.new(:timeout, "#{to} has not taken over part #{part} in time")}
        else
          receive do
          after
            20 -> await_takeover(deployment, part, to, deadline)
          end
        end
    end
  end

  @doc """
  Moves every part away from a node. The node then takes a part only if no other node is left, or if `move/3` assigns
  it. If several nodes were drained, the first of them takes such a part.
  """
  @spec drain(t(), node()) :: :ok
  def drain(%Deployment{} = deployment, node) do
    {own_runners, others} = deployment |> runners_by_node() |> Map.pop(node, %{})
    demotions = for {_, runners} <- others, {_, runner} <- runners, do: demotion_level(runner)

    for {_, runner} <- own_runners,
        do: Runner.release_part(runner, 1 + Enum.max(demotions, fn -> 0 end))

    :ok
  end

  @doc """
  Moves one part to a less busy node, if that helps. Parts without a rule can move anywhere, other parts to the nodes
  that their first rule allows. Measures for one second. Returns the moved part and its new node, or `nil`.

  The cost of a part is the time that its components spend on messages. Other CPU time, such as that of a device
  driver or of `ffmpeg`, counts only towards the load of the machine. With the option `balance:` of `deploy/2`, the
  cluster balances its parts automatically.
  """
  @spec balance(t()) :: {:ok, {String.t(), node()} | nil} | {:error, Error.t()}
  def balance(%Deployment{} = deployment) do
    before = busy_times(deployment)

    receive do
    after
      1_000 -> :ok
    end

    later = busy_times(deployment)
    {members, plan} = {Agent.list_members(), Agent.find_plan(deployment.name)}

    parts =
      for {part, {node, at, sum}} <- later, {^node, since, start} <- [before[part]] do
        on = Placement.best_nodes(members, plan.parts[part].rule)
        %{part: part, node: node, cost: (sum - start) / max(at - since, 1), on: on}
      end

    case LoadBalance.choose_move(NodeMetrics.recent_vitals(), parts) do
      nil -> {:ok, nil}
      {part, to} -> with :ok <- move(deployment, part, to), do: {:ok, {part, to}}
    end
  end

  # Returns the time (ns) that the components of each part have spent on messages so far.
  defp busy_times(deployment) do
    for {part, node, snapshot} <- part_snapshots(deployment), into: %{} do
      times = for %{kind: :process, busy: busy} <- snapshot.edges, do: busy
      {part, {node, System.monotonic_time(:nanosecond), Enum.sum(times)}}
    end
  end

  @doc "Returns a `Situ.Diagnostics.Snapshot` of the running parts, merged as if they were one pipeline."
  @spec info(t()) :: Situ.Diagnostics.Snapshot.t()
  def info(%Deployment{} = deployment),
    do: SnapshotMerge.merge_parts(deployment.name, part_snapshots(deployment))

  defp part_snapshots(deployment) do
    for %{part: part, node: node, pipeline: pid} when pid != nil <- list_parts(deployment),
        snapshot <- take_snapshot(pid),
        do: {part, node, snapshot}
  end

  defp take_snapshot(pid) do
    [Pipeline.info(pid)]
  rescue
    # The pipeline has ended.
    Error -> []
  catch
    :exit, _ -> []
  end

  defp list_parts(deployment), do: Overview.list_parts(deployment, Map.keys(Agent.info().members))

  @doc """
  Returns the state of the whole cluster as plain data. The parts, links and recordings of a node that does not reply in
  time are missing.

  | key | value |
  |---|---|
  | `time`, `own_node` | when (ns since 1970) and where the state was collected |
  | `nodes` | the `node`, its `labels`, `devices`, load (`busy`, `cores`, `machine`, `memory`), and the round `trip` to it |
  | `parts` | the `deployment` and `part`, its `phase`, `node`, `epoch`, `checkpoints`, `error`, `pipeline` and `streams` |
  | `links` | the `node`, the `address`, and the state of each link (`Situ.Link.info/1`) |
  | `recordings` | the `id` (`NODE/NAME`), `node` and `name`, whether it is `live?`, and when it `changed` (s since 1970) |

  The `streams` of a part list the parts that read them, each with the number of messages it is `behind`.
  """
  @spec overview() :: Overview.t()
  defdelegate overview, to: Overview, as: :now

  @doc """
  Returns the title of every running part on all nodes, each with a function that finds its pipeline. The studio can
  watch them (`Situ.Studio`, `pipelines:`) as if they were local, even when they move to another node.
  """
  @spec pipelines() :: [{String.t(), (() -> pid() | nil)}]
  def pipelines do
    if Process.whereis(Agent) do
      for %{deployment: d, part: part, pipeline: pid} when pid != nil <- overview().parts,
          do: {"#{d}/#{part}", fn -> Overview.find_pipeline(d, part) end}
    else
      []
    end
  end

  @doc """
  Loads new code on every node while its parts are running. Takes modules, whose code is read on this node, or
  `{module, beam}`. Returns the nodes.

      Situ.Cluster.upgrade([MyLips])
      Situ.Cluster.upgrade([{MyLips, File.read!("ebin/Elixir.MyLips.beam")}])

  One node after the other, this one last, loads the code and restarts its parts from a checkpoint taken for this
  purpose. As when a part moves, no message is lost or repeated.

  The new components must accept the saved states of the old ones, and the graph must be split into the same parts and
  streams. If a node cannot meet these conditions, it and all previous nodes return to the old code, and the error gives
  the reason. Deploy a pipeline with another graph under another name.

  An upgrade replaces only modules. To install a new release, call `drain/2` for a node, restart it, and continue with
  the next node.
  """
  @spec upgrade([module() | {module(), binary()}]) :: {:ok, [node()]} | {:error, Error.t()}
  def upgrade(modules) do
    with :ok <- check_member(),
         {:ok, code} <- Upgrade.collect_code(modules),
         do: Upgrade.upgrade_nodes(code)
  end

  @doc """
  Returns the last lines, at most `max`, that a member has logged after line number `from`, oldest first: `n` (the
  number), `time` (ns since 1970), `level` and `text`. A member keeps 2,000 lines.
  """
  @spec logs(node(), non_neg_integer(), pos_integer()) ::
          {:ok, [LogLines.line()]} | {:error, Error.t()}
  def logs(node \\ node(), from \\ 0, max \\ 200) do
    {:ok, :erpc.call(node, LogLines, :read, [from, max], 10_000)}
  catch
    _, reason ->
      {:error, Error.new(:unreachable, "#{node} is lost: #{inspect(reason, limit: 5)}")}
  end

  # A node that does not reply in time counts as a node without runners.
  defp runners_by_node(deployment) do
    nodes = Map.keys(Agent.info().members)

    {answers, _silent} =
      GenServer.multi_call(nodes, Agent, {:runners, deployment.name}, @answer_ms)

    Map.merge(Map.new(nodes, &{&1, %{}}), Map.new(answers))
  end

  @doc """
  Returns the node for the branch of `key`, for `Situ.parallel/3`:

      Situ.parallel(faces, fn _id, face -> Recognizer.who(face) end,
        branches: {:nodes, &Situ.Cluster.choose_node(&1, on: "gpu")}
      )

  Keys are spread evenly over the nodes that the rule prefers. When a node is lost, its branches fail, and with
  `on_branch_error: :restart` start again on other nodes. Raises `Situ.Error` `:no_node` if the rule is `only:` and
  excludes all members.

    * `on:`, `only:`: as in the rules of `place:` in `deploy/2`; by default, all members
  """
  @spec choose_node(term(), keyword()) :: node()
  defdelegate choose_node(key, rule \\ []), to: Member, as: :choose_branch_node!

  @doc "Returns how a pipeline would be split: the names of the parts and the streams between them."
  @spec plan(module(), keyword()) ::
          {:ok, %{parts: [String.t()], streams: [map()]}} | {:error, Error.t()}
  def plan(module, opts \\ []) do
    with {:ok, deployment} <- Deployment.new(module, opts),
         {:ok, %Plan{} = plan} <- PartStarter.build_plan(deployment) do
      streams = for {name, s} <- plan.streams, do: %{name: name, from: s.part, to: s.readers}
      {:ok, %{parts: Enum.sort(Map.keys(plan.parts)), streams: Enum.sort_by(streams, & &1.name)}}
    end
  end
end
