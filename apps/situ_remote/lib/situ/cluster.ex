defmodule Situ.Cluster do
  @moduledoc """
  One pipeline over several nodes, which goes on when a node is lost.

      # on every node (or in its supervision tree: {Situ.Cluster, log: ..., labels: [...]})
      {:ok, _} = Situ.Cluster.start_link(log: "/var/lib/situ/log", labels: ["camera"])

      # on one of them
      {:ok, deployment} =
        Situ.Cluster.deploy(Lobby,
          place: [{"Lips", on: "camera"}, {"Recording", on: :"situ@store.local"}],
          checkpoint: Situ.Time.s(1)
        )

  Nodes are connected by Erlang distribution (`Node.connect/1`) and share one log (`Situ.Remote.Log`): a folder for
  nodes of one machine, NATS for several.

  ## Parts

  The rules of `place:` cut the graph into parts: a rule names a component or a composite, and takes all below it; what
  no rule names is the part `"rest"`. A part runs on one node, as a pipeline of its own; streams between parts are
  GenStage edges with the same back-pressure, from its publisher to the parts that read it; the log is written beside
  them, for takeover. Streams that all their readers take by a lossy policy, and those of `direct:`, bypass it.

  Sources of a part that waits for what it puts out itself, through others, are a part of their own beside it
  (`"rest sources"`), placed by the same rule.

  Every node has the module and builds the same graph. `build/2` is called on each of them, with the same options.

  ## A node is lost

  Each part has a lease in the log, which its node writes again every quarter of `lease:`. When that stops (or, sooner,
  when Erlang says that the node is down) another node takes it: it fences the part's streams, so that the old node
  cannot write any more even if it is still alive, starts the part from its last checkpoint and reads its inputs from
  there. Values and originating times are as without the loss:

    * by default what a part puts out is seen by nobody before a checkpoint holds it (the outbox): right for every part,
      and its outputs come with its checkpoints, every `checkpoint:`;
    * a part declared `deterministic: true` is seen at once: started again it makes the same, and what is there
      already is passed over. Its inputs alone, their values and originating times, must decide what it puts out: use
      reproducible operators, no clock, no randomness.

  A component whose state is not plain data has `c:Situ.Component.snapshot/1` and `c:Situ.Component.restore/2`. A
  deterministic part without them is started again from the first message of its inputs; any other part that others
  read is refused, with an error that names the component.

  Sources on a lost device are lost with it: the cluster does not make up data that no device recorded.

  ## Limits

  Messages under way on a direct stream when a node is lost are lost. A recording cannot be carried over: a part that
  records is started again from the first message of the log, into a new version, and fails where `retain:` has taken
  that away. `Situ.Pipeline.on/4` handlers run with the part `"rest"` and with parts that record; those of a resource
  (a recording, a link) with the parts that use it. The log of a finished deployment stays until `prune/2` deletes it.
  An upgrade does not change the graph.

  The log contains the deployments too. Nodes that were all lost at once run them again when they are back, except those
  that have ended or were forgotten. The log's entries are sealed with the cluster's cookie. An entry that somebody else
  wrote, changed or moved is never data, and the part that reads it fails with the reason.

  ## Options of `deploy/2`

  #{Situ.Options.docs(Situ.Cluster.Deployment.schema())}

  ## Rules of `place:`

  #{Situ.Options.docs(Situ.Cluster.Deployment.place_schema())}
  """
  alias Situ.Cluster.{Agent, Assembly, Balance, Balancer, Chunk, Deployment, Logs, Overview}
  alias Situ.Cluster.{Deployments, Past, Placement, Plan, Recordings, Runner, Runners}
  alias Situ.Cluster.{Seal, SealedLog, Upgrade, Vitals, Whole}
  alias Situ.{Error, Options, Pipeline}
  alias Situ.Remote.Log

  @schema [
    log: [type: {:or, [:string, {:struct, Log}]}, required: true, doc: "The log, or its address."],
    log_options: [type: :keyword, default: [], doc: "Options of `Situ.Remote.Log.connect/2`."],
    labels: [
      type: {:list, :string},
      default: [],
      doc: "Labels of this node, for the rules of `place:`."
    ],
    devices: [
      type: {:list, :string},
      default: [],
      doc: "The devices plugged in here, by the names that rules `on: {:near, device}` use."
    ],
    recordings: [
      type: {:optional, :string},
      default: nil,
      doc: "A folder whose recordings every node may open (`Situ.Cluster.Recordings`)."
    ]
  ]

  # A node of a busy cluster gets this long to answer.
  @answer_ms 5_000

  @typedoc "The result of `deploy/2`; it is valid on every node."
  @type t :: Deployment.t()

  @doc "For a supervisor: `{Situ.Cluster, log: address, labels: [...]}`."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(opts), do: %{id: __MODULE__, start: {__MODULE__, :start_link, [opts]}}

  @doc """
  Makes this node a member of the cluster. Waits for a NATS server that is not running yet, and logs the reason.

  #{Options.docs(@schema)}
  """
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, log} <- log(opts[:log], opts[:log_options]),
         do:
           Agent.start_link(
             log: log,
             labels: opts[:labels],
             devices: opts[:devices],
             beside: [{Balancer, &balance/1}, {Recordings, opts[:recordings]}]
           )
  end

  @doc "As `start_link/1`, for shells and scripts: it does not end with its caller."
  @spec join(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def join(opts) do
    with {:ok, agent} <- start_link(opts) do
      Process.unlink(agent)
      {:ok, agent}
    end
  end

  defp log(%Log{} = log, _opts), do: {:ok, log}
  # The node waits for a server that is not running yet, as it does for a lost one.
  defp log("nats://" <> _ = address, opts), do: Log.connect(address, [wait: true] ++ opts)
  defp log(address, opts), do: Log.connect(address, opts)

  @doc "Runs a pipeline over the cluster; options above."
  @spec deploy(module(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def deploy(module, opts \\ []) do
    with {:ok, deployment} <- Deployment.new(module, opts),
         :ok <- member(),
         do: Agent.deploy(deployment)
  end

  defp member do
    if Process.whereis(Agent) do
      :ok
    else
      {:error,
       Error.new(:no_cluster, "this node is no member of a cluster",
         fix: "start it with Situ.Cluster.start_link(log: ...)"
       )}
    end
  end

  @doc """
  Waits until all parts have ended; `{:error, error}` when one has failed, or after `timeout` ms (`:timeout`).
  """
  @spec await(t(), timeout()) :: :ok | {:error, Error.t()}
  def await(%Deployment{} = deployment, timeout \\ :infinity) do
    with {:ok, plan} <- Assembly.plan(deployment) do
      till = if timeout == :infinity, do: :infinity, else: now() + timeout
      await(log(deployment), deployment, Map.keys(plan.parts), till)
    end
  end

  defp log(%Deployment{run: run}), do: SealedLog.new(Agent.log(), run || "")

  # A failed part is reported at once, even while others run; so is a refused entry in place of its state.
  defp await(log, deployment, parts, till) do
    states =
      for part <- parts, do: {part, Log.last(log, {:key, Runner.key(deployment, part, "state")})}

    open =
      for {part, state} <- states,
          not match?({:ok, %{head: %{"State" => "done"}}}, state),
          do: part

    failed =
      for {part, {:ok, %{head: %{"State" => "failed"}, data: text}}} <- states, do: {part, text}

    forged = for {_, {:error, error}} <- states, Seal.refusal?(error), do: error

    cond do
      forged != [] -> {:error, hd(forged)}
      failed != [] -> {:error, failure(deployment, hd(failed))}
      open == [] -> :ok
      till != :infinity and now() > till -> {:error, late(deployment, hd(open))}
      true -> wait(log, deployment, open, till)
    end
  end

  defp wait(log, deployment, parts, till) do
    receive do
    after
      50 -> await(log, deployment, parts, till)
    end
  end

  defp failure(deployment, {part, text}),
    do: Error.new(:part_failed, "part #{part} of #{deployment.name} failed: #{text}")

  defp late(deployment, part),
    do: Error.new(:timeout, "part #{part} of #{deployment.name} has not ended yet")

  defp now, do: System.monotonic_time(:millisecond)

  @doc "The messages of a stream that are in the log: one that crosses from part to part, or is in `publish:`."
  @spec read(t(), String.t()) :: {:ok, [Situ.Message.t()]} | {:error, Error.t()}
  def read(%Deployment{} = deployment, stream),
    do: read(log(deployment), {:stream, "#{deployment.name}.#{stream}"}, 1, [])

  defp read(log, subject, from, read) do
    case Log.read(log, subject, from, 64) do
      {:ok, []} ->
        {:ok, read |> Enum.reverse() |> Enum.concat()}

      {:ok, entries} ->
        with {:ok, lists} <- decoded(entries, []),
             do: read(log, subject, List.last(entries).seq + 1, [lists | read])

      error ->
        error
    end
  end

  defp decoded([], lists), do: {:ok, lists |> Enum.reverse() |> Enum.concat()}

  defp decoded([entry | rest], lists) do
    with {:ok, messages} <- Chunk.messages(entry), do: decoded(rest, [messages | lists])
  end

  @doc """
  Stops a deployment: its sources first; then the parts handle all posted messages. Returns at once; see `await/2`.
  """
  @spec stop(t()) :: :ok
  def stop(%Deployment{} = deployment) do
    for {_node, runners} <- everywhere(deployment),
        {_, runner} <- runners,
        do: Runner.stop(runner)

    :ok
  end

  @doc "Takes a deployment away on all nodes, at once; its log stays."
  @spec forget(t()) :: :ok | {:error, Error.t()}
  def forget(%Deployment{name: name}), do: Agent.forget(name)

  @doc "Lists, for each deployment, running or ended, how much the cluster's log keeps of it."
  @spec kept() :: {:ok, [Past.t()]} | {:error, Error.t()}
  def kept, do: with(:ok <- member(), do: Past.list(Agent.log()))

  @doc """
  Deletes for good what the log keeps of a deployment that has ended (it is then forgotten, too) or that was forgotten.
  One that runs is refused (`:in_use`), also when it runs on a cluster of others that uses the same log: the leases are
  watched for `wait` ms, or half of that deployment's `lease:` if that is more. Returns the number of
  subjects, streams and keys, that are gone.
  """
  @spec prune(String.t(), non_neg_integer()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def prune(name, wait \\ 1_500) when is_binary(name) do
    with {:ok, all} <- kept(),
         {:ok, kept} <- Past.find(all, name),
         {:ok, tries} <- over(Enum.find(Agent.info().deployments, &(&1.name == name))),
         :ok <- unused(kept, wait, tries),
         {:ok, deleted} <- Past.delete(Agent.log(), kept),
         :ok <- Deployments.delete(Agent.log(), name),
         do: {:ok, deleted}
  end

  # Other nodes may write a lease once more until they have heard that it is forgotten.
  defp unused(kept, wait, tries) do
    with {:error, %{code: :in_use}} when tries > 1 <- Past.unused(Agent.log(), kept, wait),
         do: unused(kept, wait, tries - 1)
  end

  # How often the leases are watched.
  defp over(nil), do: {:ok, 1}

  defp over(deployment) do
    case await(deployment, 0) do
      {:error, %{code: :timeout}} -> {:error, Past.in_use(deployment.name)}
      _ended_or_failed -> with :ok <- forget(deployment), do: {:ok, 3}
    end
  end

  @doc """
  The members, with their labels, and of every part: which node runs it, its phase (`:running`, `:done`, `:failed`,
  `:standby` when nobody has it at the moment), epoch of its lease, checkpoints, streams with their counts.
  """
  @spec status(t()) :: %{members: map(), parts: %{String.t() => map()}}
  def status(%Deployment{} = deployment) do
    asked =
      for {node, runners} <- everywhere(deployment),
          {part, runner} <- runners,
          do: {part, node, runner}

    answers = asked |> Enum.map(&elem(&1, 2)) |> Runners.infos(@answer_ms)
    infos = Enum.zip_with(asked, answers, fn {part, node, _}, info -> {part, node, info} end)

    parts =
      for {part, entries} <- Enum.group_by(infos, &elem(&1, 0)), into: %{} do
        owner =
          Enum.find(entries, fn {_, _, info} -> info[:phase] in [:running, :done, :failed] end)

        {part, shown(owner)}
      end

    %{members: Agent.info().members, parts: parts}
  end

  defp runner_info(runner) do
    Runner.info(runner)
  catch
    :exit, _ -> %{}
  end

  defp shown(nil), do: %{phase: :standby, node: nil}
  defp shown({_, node, info}), do: Map.put(info, :node, node)

  @doc """
  Moves a part to a node, without losing a message: a checkpoint, then the other node takes it over. `{:error, error}`
  when that node is no member.
  """
  @spec move(t(), String.t(), node()) :: :ok | {:error, Error.t()}
  def move(%Deployment{} = deployment, part, to) do
    runners =
      for {node, %{^part => runner}} <- everywhere(deployment), into: %{}, do: {node, runner}

    case Map.pop(runners, to) do
      {nil, _} ->
        {:error,
         Error.new(:no_such_part, "#{to} has no part #{inspect(part)} of #{deployment.name}",
           fix: "see Situ.Cluster.status/1 for members and parts"
         )}

      {runner, others} ->
        stood = for {_, other} <- others, do: {other, away(other)}
        # Also a node that was drained takes what it is given.
        :ok = Runner.stand(runner, 0)
        for {other, away} <- stood, do: Runner.release(other, away + 1, self())
        answer = settle(deployment, part, to, now() + 60_000)
        for {other, away} <- stood, do: Runner.stand(other, away)
        answer
    end
  end

  defp away(runner), do: Map.get(runner_info(runner), :away, 0)

  defp settle(deployment, part, to, till) do
    case status(deployment).parts do
      %{^part => %{node: ^to}} ->
        :ok

      _ ->
        if now() > till do
          {:error, Error.new(:timeout, "#{to} did not take part #{part} over")}
        else
          receive do
          after
            20 -> settle(deployment, part, to, till)
          end
        end
    end
  end

  @doc """
  Moves every part away from a node, which then takes no part unless no other node is left, or `move/3` gives it one. Of
  two nodes that were drained the one drained first takes them.
  """
  @spec drain(t(), node()) :: :ok
  def drain(%Deployment{} = deployment, node) do
    {mine, others} = deployment |> everywhere() |> Map.pop(node, %{})
    away = for {_, runners} <- others, {_, runner} <- runners, do: away(runner)
    for {_, runner} <- mine, do: Runner.release(runner, 1 + Enum.max(away, fn -> 0 end))
    :ok
  end

  @doc """
  Moves one part to a less busy node, if that helps: parts without a rule go anywhere, others where their first rule
  allows. Measures for a second. Returns the part it moved, or `nil`.

  The cost of a part is the time that its components spend on messages; the time of a device's driver or of `ffmpeg`
  beside them counts for the machine only. With `balance:` among the options of `deploy/2` the cluster balances by
  itself.
  """
  @spec balance(t()) :: {:ok, {String.t(), node()} | nil} | {:error, Error.t()}
  def balance(%Deployment{} = deployment) do
    before = busy(deployment)

    receive do
    after
      1_000 -> :ok
    end

    later = busy(deployment)
    {members, plan} = {Agent.known(), Agent.plan(deployment.name)}

    parts =
      for {part, {node, at, sum}} <- later, {^node, since, start} <- [before[part]] do
        on = Placement.equals(members, plan.parts[part].rule)
        %{part: part, node: node, cost: (sum - start) / max(at - since, 1), on: on}
      end

    case Balance.move(Vitals.all(), parts) do
      nil -> {:ok, nil}
      {part, to} -> with :ok <- move(deployment, part, to), do: {:ok, {part, to}}
    end
  end

  # The time that its components have spent on messages so far, ns.
  defp busy(deployment) do
    for {part, node, snapshot} <- snapshots(deployment), into: %{} do
      spent = for %{kind: :process, busy: busy} <- snapshot.edges, do: busy
      {part, {node, System.monotonic_time(:nanosecond), Enum.sum(spent)}}
    end
  end

  @doc "The deployment as one pipeline: a `Situ.Diagnostics.Snapshot` of all parts that run, joined."
  @spec info(t()) :: Situ.Diagnostics.Snapshot.t()
  def info(%Deployment{} = deployment), do: Whole.merge(deployment.name, snapshots(deployment))

  defp snapshots(deployment) do
    for %{part: part, node: node, pipeline: pid} when pid != nil <- parts(deployment),
        snapshot <- snapshot(pid),
        do: {part, node, snapshot}
  end

  defp snapshot(pid) do
    [Pipeline.info(pid)]
  rescue
    # It has ended meanwhile.
    Error -> []
  catch
    :exit, _ -> []
  end

  defp parts(deployment), do: Overview.parts(deployment, Map.keys(Agent.info().members))

  @doc "Nodes, parts, streams and links of the whole cluster now."
  @spec overview() :: Overview.t()
  defdelegate overview, to: Overview, as: :now

  @doc """
  The parts that run on all nodes, by title, each with a function that finds its pipeline: the studio watches them
  (`Situ.Studio`, `pipelines:`) as if they ran here, wherever they go meanwhile.
  """
  @spec pipelines() :: [{String.t(), (() -> pid() | nil)}]
  def pipelines do
    if Process.whereis(Agent) do
      for %{deployment: d, part: part, pipeline: pid} when pid != nil <- overview().parts,
          do: {"#{d}/#{part}", fn -> Overview.pipeline(d, part) end}
    else
      []
    end
  end

  @doc """
  New code on every node while its parts run: modules as this node has them, or `{module, beam}`. See
  `Situ.Cluster.Upgrade`.
  """
  @spec upgrade([module() | {module(), binary()}]) :: {:ok, [node()]} | {:error, Error.t()}
  def upgrade(modules) do
    with :ok <- member(), {:ok, code} <- Upgrade.code(modules), do: Upgrade.run(code)
  end

  @doc "The last lines that a member has logged, behind line number `from`."
  @spec logs(node(), non_neg_integer(), pos_integer()) ::
          {:ok, [Logs.line()]} | {:error, Error.t()}
  def logs(node \\ node(), from \\ 0, most \\ 200) do
    {:ok, :erpc.call(node, Logs, :read, [from, most], 10_000)}
  catch
    _, reason ->
      {:error, Error.new(:unreachable, "#{node} is lost: #{inspect(reason, limit: 5)}")}
  end

  # A node that does not answer in time counts as one without runners.
  defp everywhere(deployment) do
    nodes = Map.keys(Agent.info().members)

    {answers, _silent} =
      GenServer.multi_call(nodes, Agent, {:runners, deployment.name}, @answer_ms)

    Map.merge(Map.new(nodes, &{&1, %{}}), Map.new(answers))
  end

  @doc "How a pipeline would be cut into parts: their components' names, the streams between them."
  @spec plan(module(), keyword()) ::
          {:ok, %{parts: [String.t()], streams: [map()]}} | {:error, Error.t()}
  def plan(module, opts \\ []) do
    with {:ok, deployment} <- Deployment.new(module, opts),
         {:ok, %Plan{} = plan} <- Assembly.plan(deployment) do
      streams = for {name, s} <- plan.streams, do: %{name: name, from: s.part, to: s.readers}
      {:ok, %{parts: Enum.sort(Map.keys(plan.parts)), streams: Enum.sort_by(streams, & &1.name)}}
    end
  end
end
