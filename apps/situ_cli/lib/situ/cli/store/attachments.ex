defmodule Situ.CLI.Store.Attachments do
  @moduledoc false
  # `situ store attachments`: lists and extracts the attachments of an MCAP file.
  @behaviour Situ.CLI.Verb
  alias Situ.Bridge.Mcap
  alias Situ.CLI.{Option, Output, Recording, Verb}
  alias Situ.{Error, Time}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "attachments"],
        aliases: ["attachment"],
        summary: "list the attachments of an MCAP file, or extract one",
        arguments: [
          path: [kind: :recording, doc: "an MCAP file"],
          name: [kind: :text, optional: true, doc: "the attachment to extract"]
        ],
        options: [
          Option.new(:output, :path, "the file to write (default: standard output)",
            short: :o,
            value: "FILE"
          )
        ],
        examples: ["situ store attachments drive.mcap calibration.yaml -o calibration.yaml"],
        run: &run_attachments/2
      }
    ]
  end

  defp run_attachments(%{path: path, name: name}, opts) do
    store = Recording.open!(path)

    unless store.module == Mcap,
      do:
        raise(
          Error.new(:no_attachments, "#{path} is not an MCAP file",
            why: "only MCAP files have attachments"
          )
        )

    if name, do: extract_attachment(store, name, opts), else: list_attachments(store, opts)
  end

  defp list_attachments(store, opts) do
    all = Mcap.list_attachments(store)

    cond do
      opts[:json] ->
        Output.print_json(all)

      all == [] ->
        Output.puts("#{store.path} has no attachments.")

      true ->
        Output.print_table(
          [["attachment", "type", "time", "size"] | Enum.map(all, &attachment_row/1)],
          2
        )
    end

    0
  end

  defp attachment_row(a),
    do: [a.name, a.media_type, Time.to_iso8601(a.time), Output.format_bytes(a.size)]

  defp extract_attachment(store, name, opts) do
    bytes = Error.unwrap!(Mcap.read_attachment(store, name))

    case opts[:output] do
      nil ->
        Output.write_raw(bytes)

      file ->
        with {:error, reason} <- File.write(file, bytes) do
          raise Error.new(:not_saved, "cannot write #{file}",
                  why: to_string(:file.format_error(reason))
                )
        end

        if opts[:json], do: Output.print_json(%{name: name, file: file, size: byte_size(bytes)})
    end

    0
  end
end
