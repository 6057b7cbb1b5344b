defmodule Situ.CLI.Verb do
  @moduledoc """
  One thing that `situ` does, as a table: its words, arguments, options and examples. Parsing, `--help`, the manual
  and the completion of shells are all made from it; nothing about a verb is written twice.

  A module of verbs has the behaviour `Situ.CLI.Verb`: `verbs/0` returns them, and `Situ.CLI.Commands` lists the
  module.

      %Situ.CLI.Verb{
        words: ["store", "rename"],
        summary: "give a recording another name",
        arguments: [path: [kind: :recording, doc: "the store"], name: [kind: :text, doc: "its new name"]],
        options: [],
        examples: ["situ store rename recordings/lobby.0000 entrance"],
        run: &Care.rename/2
      }

  `run` gets the arguments as a map (a list where `many: true`), and the options as a keyword list of values already
  read, with defaults; options that may be given several times are lists. It answers with the exit status, or raises
  a `Situ.Error`, which is printed and becomes status 1.
  """
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

  @typedoc "`kind:` `:recording`, `:new` (a recording to be made), `:file`, `:folder` or `:text`; `many:`, `optional:`."
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

  @doc "The verbs of a module, in the order that help shows them."
  @callback verbs() :: [t()]

  @common [
    Option.new(:json, :flag, "for programs: JSON on standard output"),
    Option.new(:quiet, :flag, "no progress bar", short: :q),
    Option.new(:help, :flag, "this text", short: :h)
  ]

  @doc "The options of every verb."
  @spec common() :: [Option.t()]
  def common, do: @common

  @doc "All options of a verb."
  @spec options(t()) :: [Option.t()]
  def options(%__MODULE__{options: options}), do: options ++ @common

  @doc "The verb as it is typed: `situ store rename PATH NAME`."
  @spec usage(t()) :: String.t()
  def usage(%__MODULE__{} = verb) do
    arguments = Enum.map(verb.arguments, fn {name, spec} -> argument(name, spec) end)
    Enum.join(["situ" | verb.words] ++ arguments ++ ["[OPTIONS]"], " ")
  end

  @doc "An argument as help names it: `PATH...`, `[NAME]`."
  @spec argument(atom(), keyword()) :: String.t()
  def argument(name, spec) do
    word = name |> Atom.to_string() |> String.upcase()
    word = if spec[:many], do: word <> "...", else: word
    if spec[:optional], do: "[#{word}]", else: word
  end
end
