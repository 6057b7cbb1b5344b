defmodule Situ.CLI.ClusterKept do
  @moduledoc false
  # The verbs of `situ cluster` for what the log keeps of deployments: a list, and taking away what is over.
  alias Situ.{Cluster, Error}
  alias Situ.CLI.{ClusterNode, Option, Output, Verb}

  @doc "`ask` calls a function on a node of the cluster."
  @spec verbs([Option.t()], ClusterNode.ask()) :: [Verb.t()]
  def verbs(common, ask) do
    [
      %Verb{
        words: ["cluster", "kept"],
        summary: "what the log keeps of each deployment, running and ended ones",
        about:
          "A log in NATS costs its server two open files for each stream; `situ cluster prune` frees them.",
        options: common,
        examples: ["situ cluster kept --node situ-9301@127.0.0.1"],
        run: fn _, opts -> kept(opts, ask) end
      },
      %Verb{
        words: ["cluster", "prune"],
        summary: "delete for good what the log keeps of deployments that have ended",
        about: """
        Names deployments, or all that were not written to for a while (--older-than). Nothing is deleted of one that
        runs, here or on another cluster with the same log. --dry-run says what would be deleted.
        """,
        arguments: [
          deployments: [kind: :text, many: true, optional: true, doc: "what was deployed"]
        ],
        options: [
          Option.new(:older_than, :span, "all that were last written to so long ago"),
          Option.new(:dry_run, :flag, "delete nothing")
          | common
        ],
        examples: [
          "situ cluster prune Hall --node situ-9301@127.0.0.1",
          "situ cluster prune --older-than 24h --node situ-9301@127.0.0.1"
        ],
        run: fn %{deployments: names}, opts -> prune(names, opts, ask) end
      }
    ]
  end

  defp kept(opts, ask) do
    kept = Error.unwrap!(ask.(opts, Cluster, :kept, []))
    known = for d <- ask.(opts, Cluster.Agent, :info, []).deployments, do: d.name

    if opts[:json],
      do: Output.json(Enum.map(kept, &row(&1, known))),
      else: Enum.each(kept, &print(&1, known))

    0
  end

  defp row(kept, known) do
    kept
    |> Map.take([:deployment, :streams, :entries, :bytes])
    |> Map.merge(%{
      known: kept.deployment in known,
      written: kept.written && Situ.Time.to_iso8601(kept.written)
    })
  end

  defp print(kept, known) do
    r = row(kept, known)
    where = if r.known, do: "", else: ", on no node here"
    size = "#{r.streams} streams, #{r.entries} entries, #{r.bytes} bytes"

    Output.puts(
      "#{Output.name(r.deployment)}: #{size}, last written #{r.written || "never"}#{where}"
    )
  end

  defp prune(names, opts, ask) do
    found = if opts[:older_than], do: old(opts, ask), else: []

    if names == [] and opts[:older_than] == nil do
      raise Error.new(:usage, "which deployments?",
              fix: "name them (see `situ cluster kept`), or give --older-than 24h"
            )
    end

    results = for name <- Enum.uniq(names ++ found), do: pruned(name, name in names, opts, ask)
    if results == [], do: Output.puts("nothing is that old")
    Enum.max(results, fn -> 0 end)
  end

  defp old(opts, ask) do
    latest = Situ.Time.now() - opts[:older_than]

    for kept <- Error.unwrap!(ask.(opts, Cluster, :kept, [])),
        kept.written != nil and kept.written <= latest,
        do: kept.deployment
  end

  defp pruned(name, named?, opts, ask) do
    if opts[:dry_run] do
      Output.puts("#{Output.name(name)}: would be deleted if it has ended")
      0
    else
      told(ask.(opts, Cluster, :prune, [name]), name, named?)
    end
  end

  defp told({:ok, n}, name, _named?) do
    Output.puts("#{Output.name(name)}: deleted, #{n} streams and keys")
    0
  end

  # One that runs was not asked for by name: then it is no mistake.
  defp told({:error, %{code: :in_use} = error}, _name, false) do
    Output.warn(Exception.message(error))
    0
  end

  defp told({:error, error}, _name, _named?) do
    Output.warn(Exception.message(error))
    1
  end
end
