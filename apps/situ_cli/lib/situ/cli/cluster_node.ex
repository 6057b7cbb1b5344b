defmodule Situ.CLI.ClusterNode do
  @moduledoc false
  # The verbs of `situ cluster` for nodes: their logs, code and load, and the studio of a node.
  alias Situ.{Cluster, Diagnostics, Error}
  alias Situ.CLI.{ClusterDeployment, ClusterRetention, Option, Output, Verb}

  @again_ms 500

  @type ask :: (keyword(), module(), atom(), list() -> term())

  @doc "Returns the verbs; `ask` calls a function on a node of the cluster, `folder` returns the identity's folder."
  @spec node_verbs([Option.t()], ask(), (keyword() -> Path.t())) :: [Verb.t()]
  def node_verbs(common, ask, folder) do
    [
      %Verb{
        words: ["cluster", "logs"],
        summary: "show the latest log lines of the nodes",
        about:
          "Each node keeps its last 2,000 lines. Without --of, the lines of all nodes are shown in order of time.",
        options: [
          Option.new(:of, :string, "only this node", value: "NODE", many?: true),
          Option.new(:number, :integer, "this many lines of each node", short: :n, default: 50),
          Option.new(:follow, :flag, "continue with new lines (until Ctrl-C)", short: :f)
          | common
        ],
        examples: ["situ cluster logs --node situ-9301@127.0.0.1 --follow"],
        run: fn _, opts -> show_logs(opts, ask) end
      },
      %Verb{
        words: ["cluster", "info"],
        summary: "show a deployment as one pipeline: components, edges, rates, queues",
        arguments: [deployment: [kind: :text, doc: "the deployment's name"]],
        options: common,
        examples: ["situ cluster info Hall --node situ-9301@127.0.0.1"],
        run: fn %{deployment: name}, opts -> show_info(name, opts, ask) end
      },
      %Verb{
        words: ["cluster", "upgrade"],
        summary: "load new code on all nodes while their parts are running",
        about: """
        FILE is a compiled module (.beam), or Elixir source (.ex, .exs) whose modules are compiled here. The nodes load
        them one after another and restart their parts, each from a checkpoint. If a node fails, all nodes keep their
        previous code.
        """,
        arguments: [files: [kind: :file, many: true, doc: "compiled modules or Elixir source"]],
        options: common,
        examples: ["situ cluster upgrade lips.ex --node situ-9301@127.0.0.1"],
        run: fn %{files: files}, opts -> upgrade_code(files, opts, ask) end
      },
      %Verb{
        words: ["cluster", "balance"],
        summary: "move a part of a deployment to a less busy node, if that helps",
        arguments: [deployment: [kind: :text, doc: "the deployment's name"]],
        options: common,
        examples: ["situ cluster balance Hall --node situ-9301@127.0.0.1"],
        run: fn %{deployment: name}, opts -> balance_deployment(name, opts, ask) end
      }
      | ClusterRetention.log_verbs(common, ask, folder)
    ]
  end

  defp show_logs(opts, ask) do
    nodes = resolve_nodes(opts, ask)
    lines = for node <- nodes, do: {node, read_lines(node, 0, opts[:number], opts, ask)}
    for {node, line} <- by_time(lines), do: print_line(node, line)
    if opts[:follow], do: follow_logs(last_positions(lines, Map.new(nodes, &{&1, 0})), opts, ask)
    0
  end

  defp show_info(name, opts, ask) do
    snapshot = ask.(opts, Cluster, :info, [ClusterDeployment.find_deployment(name, opts, ask)])

    for n <- Enum.sort_by(snapshot.nodes, & &1.path),
        do: Output.puts("#{n.path}: #{n.description}")

    Output.puts(Diagnostics.format(snapshot))
    0
  end

  defp resolve_nodes(opts, ask) do
    known = ask.(opts, Cluster.Agent, :info, []).members |> Map.keys() |> Enum.sort()

    case opts[:of] do
      [] -> known
      names -> Enum.map(names, &find_node(&1, known))
    end
  end

  defp find_node(name, known) do
    Enum.find(known, &(Atom.to_string(&1) == name)) ||
      raise Error.new(:not_found, "#{name} is not a node of the cluster",
              fix: "nodes: " <> Enum.join(known, ", ")
            )
  end

  # An unreachable node is reported once and polled again later.
  defp read_lines(node, from, most, opts, ask) do
    case ask.(opts, Cluster, :logs, [node, from, most]) do
      {:ok, lines} ->
        lines

      {:error, error} ->
        if from >= 0, do: Output.warn(Exception.message(error))
        []
    end
  end

  defp follow_logs(marks, opts, ask) do
    receive do
    after
      @again_ms -> :ok
    end

    lines = for {node, from} <- marks, do: {node, read_lines(node, from, 2_000, opts, ask)}
    for {node, line} <- by_time(lines), do: print_line(node, line)
    follow_logs(last_positions(lines, marks), opts, ask)
  end

  defp last_positions(lines, before) do
    for {node, lines} <- lines, lines != [], into: before, do: {node, List.last(lines).n}
  end

  defp by_time(lines) do
    all = for {node, lines} <- lines, line <- lines, do: {node, line}
    Enum.sort_by(all, fn {_, line} -> line.time end)
  end

  defp print_line(node, line) do
    Output.puts(
      "#{Situ.Time.to_iso8601(line.time)}  #{node}  [#{line.level}] #{Output.format_name(line.text)}"
    )
  end

  defp upgrade_code(files, opts, ask) do
    code = Enum.flat_map(files, &load_code/1)
    nodes = Error.unwrap!(ask.(opts, Cluster, :upgrade, [code]))
    names = Enum.map_join(code, ", ", fn {module, _} -> inspect(module) end)
    Output.puts("#{names}: loaded on #{Enum.join(nodes, ", ")}")
    0
  end

  defp load_code(file) do
    if Path.extname(file) == ".beam", do: [read_beam(file)], else: Code.compile_file(file)
  rescue
    error in [SyntaxError, TokenMissingError, CompileError, Code.LoadError] ->
      raise Error.new(:bad_code, "#{file} cannot be compiled: #{Exception.message(error)}")
  end

  defp read_beam(file) do
    with {:ok, bytes} <- File.read(file),
         {:ok, {module, _}} <- :beam_lib.chunks(bytes, []) do
      {module, bytes}
    else
      _ ->
        raise Error.new(:bad_code, "#{file} is not a compiled module", fix: "name a .beam file")
    end
  end

  defp balance_deployment(name, opts, ask) do
    case Error.unwrap!(
           ask.(opts, Cluster, :balance, [ClusterDeployment.find_deployment(name, opts, ask)])
         ) do
      nil -> Output.puts("no part of #{name} needs to move")
      {part, to} -> Output.puts("#{name}/#{part} is now running on #{to}, which is less busy")
    end

    0
  end

  @doc "Starts a studio on this node, with the pipelines and recordings of all nodes, and returns its URL."
  @spec start_studio(:inet.port_number(), Path.t() | nil) :: String.t()
  def start_studio(port, path) do
    {:ok, _} = Application.ensure_all_started(:situ_studio)

    settings = [
      port: port,
      path: path,
      pipelines: [{:all, &Cluster.pipelines/0}],
      recordings: &Cluster.Recordings.fetch_address/1
    ]

    {:ok, studio} = settings |> Situ.Studio.start_link() |> Error.unwrap!() |> then(&{:ok, &1})
    Situ.Studio.url(studio)
  end
end
