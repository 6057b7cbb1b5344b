defmodule Situ.CLI.Verb do
  @moduledoc false
  # A verb of `situ` as a table: its words, arguments, options and examples. Parsing, `--help`,
  # the manual and shell completion are all derived from this table, so nothing about a verb is
  # written twice.
  #
  # A module of verbs implements the behaviour `Situ.CLI.Verb`: `verbs/0` returns them, and
  # `Situ.CLI.Commands` lists the module.
  #
  #     %Situ.CLI.Verb{
  #       words: ["store", "rename"],
  #       summary: "rename a store",
  #       arguments: [path: [kind: :recording, doc: "the store"], name: [kind: :text, doc: "the new name"]],
  #       options: [],
  #       examples: ["situ store rename recordings/lobby.0000 entrance"],
  #       run: &Maintenance.rename_store/2
  #     }
  #
  # `run` receives the arguments as a map (with a list for `many: true`), and the options as a
  # keyword list of parsed values and defaults. Options that may be given several times are lists.
  # It returns the exit status or raises a `Situ.Error`, which is printed and results in status 1.
  alias Situ.CLI.Option

  @enforce_keys [:words, :summary, :run]
  defstruct [
    :words,
    :summary,
    :run,
    about: "",
    arguments: [],
    options: [],
    examples: [],
    aliases: []
  ]

  @typedoc "`kind:` `:recording`, `:new` (a new recording), `:file`, `:folder` or `:text`; also `many:`, `optional:`."
  @type argument :: {atom(), keyword()}
  @type t :: %__MODULE__{
          words: [String.t()],
          summary: String.t(),
          about: String.t(),
          arguments: [argument()],
          options: [Option.t()],
          examples: [String.t()],
          aliases: [String.t()],
          run: (map(), keyword() -> 0..255)
        }

  @doc "Returns the verbs of a module, in the order that help shows them."
  @callback verbs() :: [t()]

  @common [
    Option.new(:json, :flag, "print JSON to standard output, for programs"),
    Option.new(:quiet, :flag, "do not show a progress bar", short: :q),
    Option.new(:help, :flag, "print this text", short: :h)
  ]

  @doc "Returns the options that all verbs have."
  @spec common_options() :: [Option.t()]
  def common_options, do: @common

  @doc "Returns all options of a verb."
  @spec all_options(t()) :: [Option.t()]
  def all_options(%__MODULE__{options: options}), do: options ++ @common

  @doc "Returns the verb as it is typed: `situ store rename PATH NAME`."
  @spec usage_line(t()) :: String.t()
  def usage_line(%__MODULE__{} = verb) do
    arguments = Enum.map(verb.arguments, fn {name, spec} -> argument_label(name, spec) end)
    Enum.join(["situ" | verb.words] ++ arguments ++ ["[OPTIONS]"], " ")
  end

  @doc "Returns the name of an argument in help: `PATH...`, `[NAME]`."
  @spec argument_label(atom(), keyword()) :: String.t()
  def argument_label(name, spec) do
    word = name |> Atom.to_string() |> String.upcase()
    word = if spec[:many], do: word <> "...", else: word
    if spec[:optional], do: "[#{word}]", else: word
  end
end
