defmodule Situ.CLI.ClusterRetention do
  @moduledoc false
  # The verbs of `situ cluster` for the logs of deployments: list all logs, and delete the logs of ended deployments.
  alias Situ.{Cluster, Error}
  alias Situ.CLI.{ClusterLogOptions, ClusterNode, Option, Output, Verb}
  alias Situ.Cluster.Retention
  alias Situ.Cluster.Log

  @log Option.new(
         :log,
         :string,
         "read the log directly when no node is running: a folder, or nats://host:4222",
         value: "ADDRESS"
       )
  @watched_ms 1_500

  @doc "Returns the verbs; `ask` calls a function on a node of the cluster, `folder` returns the identity's folder."
  @spec log_verbs([Option.t()], ClusterNode.ask(), (keyword() -> Path.t())) :: [Verb.t()]
  def log_verbs(common, ask, folder) do
    common = common ++ ClusterLogOptions.log_options()

    [
      %Verb{
        words: ["cluster", "kept"],
        summary: "list the logs of all deployments, running and ended",
        about:
          "With a log in NATS, each stream costs the server two open files; `situ cluster prune` frees them.",
        options: [@log | common],
        examples: [
          "situ cluster kept --node situ-9301@127.0.0.1",
          "situ cluster kept --log nats://lab1:4222"
        ],
        run: fn _, opts -> opts |> log_access(ask, folder) |> list_logs(opts) end
      },
      %Verb{
        words: ["cluster", "prune"],
        summary: "permanently delete the logs of deployments that have ended",
        about: """
        Give the names of deployments, or --older-than for all that were not written to for a while. The log of a
        running deployment is never deleted, even if it is running on another cluster with the same log (with --log,
        its leases show that). --dry-run prints the deployments whose logs would be deleted.
        """,
        arguments: [
          deployments: [kind: :text, many: true, optional: true, doc: "names of deployments"]
        ],
        options: [
          Option.new(
            :older_than,
            :span,
            "all deployments whose last write was at least this long ago"
          ),
          Option.new(:dry_run, :flag, "delete nothing"),
          @log
          | common
        ],
        examples: [
          "situ cluster prune Hall --node situ-9301@127.0.0.1",
          "situ cluster prune --older-than 24h --node situ-9301@127.0.0.1",
          "situ cluster prune Hall --log /var/lib/situ/log"
        ],
        run: fn %{deployments: names}, opts ->
          names |> prune_logs(opts, log_access(opts, ask, folder))
        end
      }
    ]
  end

  # Returns functions that list the logs, return the names of running deployments (nil if unknown), and delete a log.
  defp log_access(opts, ask, folder) do
    if opts[:log],
      do: access_by_log(opts[:log], opts, folder.(opts)),
      else: access_by_node(opts, ask)
  end

  defp access_by_node(opts, ask) do
    %{
      list: fn -> ask.(opts, Cluster, :list_log_usage, []) end,
      known: fn -> for d <- ask.(opts, Cluster.Agent, :info, []).deployments, do: d.name end,
      prune: fn name -> ask.(opts, Cluster, :prune, [name]) end
    }
  end

  defp access_by_log(address, opts, identity) do
    address = if String.contains?(address, "://"), do: address, else: existing_folder(address)
    {:ok, _} = Application.ensure_all_started(:situ_cluster)

    log =
      Error.unwrap!(
        Log.connect(address, ClusterLogOptions.connect_options(address, opts, identity))
      )

    %{
      list: fn -> Retention.list(log) end,
      known: fn -> nil end,
      prune: &Retention.prune(log, &1, @watched_ms)
    }
  end

  # Listing must not create a log folder.
  defp existing_folder(folder) do
    if File.dir?(folder),
      do: folder,
      else:
        raise(
          Error.new(:no_log, "the log folder #{folder} does not exist",
            fix: "name the folder given to `situ cluster join`"
          )
        )
  end

  defp list_logs(access, opts) do
    logs = Error.unwrap!(access.list.())
    known = access.known.()

    if opts[:json],
      do: Output.print_json(Enum.map(logs, &describe_log(&1, known))),
      else: Enum.each(logs, &print_log(&1, known))

    if logs == [] and not opts[:json], do: Output.puts("the log is empty")
    0
  end

  defp describe_log(log, known) do
    log
    |> Map.take([:deployment, :streams, :entries, :bytes])
    |> Map.merge(%{
      known: known && log.deployment in known,
      written: log.written && Situ.Time.to_iso8601(log.written)
    })
  end

  defp print_log(log, known) do
    r = describe_log(log, known)
    where = if r.known == false, do: ", on no node here", else: ""
    size = "#{r.streams} streams, #{r.entries} entries, #{r.bytes} bytes"

    Output.puts(
      "#{Output.format_name(r.deployment)}: #{size}, last written #{r.written || "never"}#{where}"
    )
  end

  defp prune_logs(names, opts, access) do
    if names == [] and opts[:older_than] == nil do
      raise Error.new(:usage, "no deployment given",
              fix: "name them (see `situ cluster kept`), or give --older-than 24h"
            )
    end

    old_names = if opts[:older_than], do: old_deployments(opts, access), else: []

    results =
      for name <- Enum.uniq(names ++ old_names),
          do: prune_deployment(name, name in names, opts, access)

    if results == [], do: Output.puts("no deployment is that old")
    Enum.max(results, fn -> 0 end)
  end

  defp old_deployments(opts, access) do
    latest = Situ.Time.now() - opts[:older_than]

    for log <- Error.unwrap!(access.list.()),
        log.written != nil and log.written <= latest,
        do: log.deployment
  end

  defp prune_deployment(name, named?, opts, access) do
    if opts[:dry_run] do
      Output.puts("#{Output.format_name(name)}: would be deleted if it has ended")
      0
    else
      report_pruned(access.prune.(name), name, named?)
    end
  end

  defp report_pruned({:ok, n}, name, _named?) do
    Output.puts("#{Output.format_name(name)}: deleted, #{n} streams and keys")
    0
  end

  # A running deployment that the user did not name, but --older-than selected, is not an error.
  defp report_pruned({:error, %{code: :in_use} = error}, _name, false) do
    Output.warn(Exception.message(error))
    0
  end

  defp report_pruned({:error, error}, _name, _named?) do
    Output.warn(Exception.message(error))
    1
  end
end
