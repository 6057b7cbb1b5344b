defmodule Situ.CLI.Annotate.Tiers do
  @moduledoc false
  # The verbs of `situ annotate` that edit the tiers of a layer. Each is one operation, which `situ annotate undo`
  # undoes.
  @behaviour Situ.CLI.Verb
  alias Situ.Annotation.{Editor, TierEdit}
  alias Situ.CLI.Annotate.Source
  alias Situ.CLI.{Option, Output, Verb}
  alias Situ.Error

  @line_doc "the tier, such as `Words in Utterance`, `Turns divides Utterance`, `Parts parts of Words`, " <>
              "`English of Utterance`"

  @impl true
  def verbs do
    [
      %Verb{
        words: ["annotate", "add-tier"],
        summary: "add a tier to a layer of annotations",
        about:
          "Values after a colon are a vocabulary. Without them, the annotations of the tier have texts.",
        arguments: [path: path_argument(), tier: [kind: :text, doc: @line_doc]],
        options: Source.layer_options(),
        examples: ["situ annotate add-tier study.json 'Kind of Words: noun, verb' --session p01"],
        run: fn args, opts -> edit_tiers(args.path, opts, &TierEdit.add_tier(&1, args.tier)) end
      },
      %Verb{
        words: ["annotate", "rename-tier"],
        summary: "rename a tier, with its annotations",
        arguments: [
          path: path_argument(),
          tier: name_argument(),
          name: [kind: :text, doc: "the new name"]
        ],
        options: Source.layer_options(),
        examples: ["situ annotate rename-tier study.json Words Tokens --session p01"],
        run: fn args, opts ->
          edit_tiers(args.path, opts, &TierEdit.rename_tier(&1, args.tier, args.name))
        end
      },
      %Verb{
        words: ["annotate", "remove-tier"],
        summary: "remove a tier from a layer of annotations",
        arguments: [path: path_argument(), tier: name_argument()],
        options: [
          Option.new(:delete, :flag, "also delete its annotations, and the tiers below it")
          | Source.layer_options()
        ],
        examples: ["situ annotate remove-tier study.json Kind --delete --session p01"],
        run: fn args, opts ->
          remove = &TierEdit.remove_tier(&1, args.tier, delete: opts[:delete] == true)
          edit_tiers(args.path, opts, remove)
        end
      },
      %Verb{
        words: ["annotate", "move-tier"],
        summary: "change the order of tiers",
        arguments: [
          path: path_argument(),
          tier: name_argument(),
          before: [
            kind: :text,
            optional: true,
            doc: "the tier that it is moved before (default: to the end)"
          ]
        ],
        options: Source.layer_options(),
        examples: ["situ annotate move-tier study.json English Words --session p01"],
        run: fn args, opts ->
          edit_tiers(args.path, opts, &TierEdit.move_tier(&1, args.tier, args[:before]))
        end
      },
      %Verb{
        words: ["annotate", "set-parent"],
        summary: "change the parent of a tier, and its relation to it",
        about: "This is refused if annotations of the tier do not fit.",
        arguments: [path: path_argument(), tier: [kind: :text, doc: @line_doc]],
        options: Source.layer_options(),
        examples: ["situ annotate set-parent study.json 'Words divides Utterance' --session p01"],
        run: fn args, opts ->
          edit_tiers(args.path, opts, &TierEdit.change_parent(&1, args.tier))
        end
      },
      %Verb{
        words: ["annotate", "set-values"],
        summary: "change the vocabulary of a tier",
        about: """
        `old -> new` renames a value, also in annotations. A value that annotations use cannot be left out. The empty
        text '' means free text. Tiers that have the same attribute get the same vocabulary.
        """,
        arguments: [
          path: path_argument(),
          tier: name_argument(),
          values: [
            kind: :text,
            doc: "all values in their order, such as 'noun, verb, adj -> adjective'"
          ]
        ],
        options: Source.layer_options(),
        examples: ["situ annotate set-values study.json Kind 'noun, verb, other' --session p01"],
        run: fn args, opts ->
          edit_tiers(args.path, opts, &TierEdit.change_values(&1, args.tier, args.values))
        end
      }
    ]
  end

  defp path_argument, do: [kind: :recording, doc: "a store of annotations, or a dataset file"]
  defp name_argument, do: [kind: :text, doc: "the name of the tier"]

  defp edit_tiers(path, opts, fun) do
    {store, stream} = Source.find_layer!(path, opts)
    editor = Error.unwrap!(Editor.start_link(path: store, stream: stream))
    layer = Error.unwrap!(Editor.edit_schema(editor, fun))
    :ok = Editor.stop(editor)
    tiers = for tier <- layer.schema.tiers, do: TierEdit.describe_tier(layer.schema, tier.name)

    if opts[:json],
      do: Output.print_json(%{tiers: tiers}),
      else: Enum.each(tiers, &Output.puts/1)

    0
  end
end
