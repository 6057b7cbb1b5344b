defmodule Situ.CLI.Commands do
  @moduledoc false
  # All verbs, in the order in which `situ --help` shows them, and the lookup of a verb.
  alias Situ.CLI.{
    Annotate,
    Cluster,
    Dataset,
    Devices,
    Doctor,
    Experiment,
    FileKinds,
    Interactive,
    New,
    Plugin,
    Query,
    Release,
    Run,
    Serve,
    Shell,
    Store,
    Studio,
    Talk,
    Task,
    Verb
  }

  @modules [
    New,
    Run,
    Interactive,
    Doctor,
    Store.Inspection,
    Store.Pyramid,
    Store.Attachments,
    Store.Import,
    Store.Copying,
    Store.Maintenance,
    Store.Export,
    Store.Exchange,
    Store.ObjectStorage,
    Dataset,
    Dataset.Versions,
    Dataset.Refreshing,
    Query,
    Task,
    Experiment,
    Annotate,
    Annotate.LayerVersions,
    Annotate.Tiers,
    Studio,
    Cluster,
    Talk,
    Serve,
    Devices,
    FileKinds,
    Plugin,
    Release,
    Shell
  ]

  @groups %{
    "store" => "inspect, check, repair, cut, copy and edit recordings",
    "dataset" => "group recordings into sessions, list them, run pipelines over them",
    "task" => "list and run batch tasks over the sessions of a dataset",
    "experiment" =>
      "run a pipeline with many parameters over a dataset, compare and check the results",
    "plugin" => "create, list and test plug-ins: visualizers, adapters, file formats, tasks",
    "cluster" => "run pipelines on several nodes: create, join, inspect, deploy, move",
    "annotate" => "exchange annotations with other programs, compare annotators"
  }

  # Verbs of the same command are adjacent, even if different modules define them.
  @spec list_verbs() :: [Verb.t()]
  def list_verbs do
    verbs = Enum.flat_map(@modules, & &1.verbs())
    order = verbs |> Enum.map(&hd(&1.words)) |> Enum.uniq()
    Enum.sort_by(verbs, fn verb -> Enum.find_index(order, &(&1 == hd(verb.words))) end)
  end

  @spec groups() :: %{String.t() => String.t()}
  def groups, do: @groups

  @doc "Returns the verb that a command line begins with, and the remaining words."
  @spec find_verb([String.t()]) ::
          {:ok, Verb.t(), [String.t()]}
          | {:group, String.t(), [Verb.t()]}
          | {:error, Situ.Error.t()}
  def find_verb([first | rest]) do
    case Enum.filter(list_verbs(), &(hd(&1.words) == first)) do
      [] -> {:error, unknown_command(first)}
      [%{words: [_]} = verb] -> {:ok, verb, rest}
      group -> find_in_group(first, rest, group)
    end
  end

  defp find_in_group(first, [], group), do: {:group, first, group}

  defp find_in_group(first, [help | _], group) when help in ["help", "--help", "-h"],
    do: {:group, first, group}

  defp find_in_group(first, [word | rest], group) do
    case Enum.find(group, &(word in [List.last(&1.words) | &1.aliases])) do
      nil -> {:error, unknown_verb(first, word, group)}
      verb -> {:ok, verb, rest}
    end
  end

  defp unknown_command(word) do
    words = list_verbs() |> Enum.map(&hd(&1.words)) |> Enum.uniq()

    fix =
      case Situ.Options.nearest_name(word, words) do
        nil -> "`situ --help` lists the commands"
        near -> "did you mean `situ #{near}`? `situ --help` lists the commands"
      end

    Situ.Error.new(:unknown_command, "unknown command #{inspect(word)}", fix: fix)
  end

  defp unknown_verb(first, word, group) do
    words = Enum.flat_map(group, &[List.last(&1.words) | &1.aliases])

    fix =
      case Situ.Options.nearest_name(word, words) do
        nil -> "see `situ #{first} --help`"
        near -> "did you mean `situ #{first} #{near}`? See `situ #{first} --help`"
      end

    Situ.Error.new(:unknown_verb, "situ #{first}: unknown verb #{inspect(word)}", fix: fix)
  end
end
