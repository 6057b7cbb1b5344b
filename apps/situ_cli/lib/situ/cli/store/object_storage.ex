defmodule Situ.CLI.Store.ObjectStorage do
  @moduledoc false
  # The verbs of `situ store` that copy recordings to and from object storage: push, pull, sync.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, TransferProgress, Verb}
  alias Situ.Error
  alias Situ.Store.S3

  @credentials """
  Credentials, region and endpoint are set as for the AWS tools: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION,
  AWS_ENDPOINT_URL, or AWS_PROFILE with ~/.aws/credentials. Addresses never contain them.
  """
  @address [
    kind: :text,
    doc: "s3://BUCKET/PREFIX/NAME; with a slash at its end, a folder for recordings"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "push"],
        summary: "upload a finished recording to object storage (S3)",
        about:
          """
          Uploads a store, the newest version of a name, or all finished segments of a recording. The recording appears
          when it is complete. If the command is stopped (Ctrl-C, a broken connection), run it again: it continues where
          it stopped, and sends nothing twice.
          """ <> @credentials,
        arguments: [
          path: [kind: :recording, doc: "the recording"],
          address: @address
        ],
        examples: [
          "situ store push recordings/lobby s3://lab/recordings/",
          "AWS_ENDPOINT_URL=http://nas:9000 situ store push recordings/lobby.0003 s3://lab/lobby"
        ],
        run: fn %{path: path, address: address}, opts ->
          run_transfer("push", opts, &S3.push(path, address, progress: &1))
        end
      },
      %Verb{
        words: ["store", "pull"],
        summary: "download a recording from object storage (S3)",
        about:
          """
          Creates ROOT/NAME.NNNN with the same contents as the uploaded store. Reading does not need this command: an
          address opens wherever a path does. If the command is stopped, run it again.
          """ <> @credentials,
        arguments: [
          address: Keyword.put(@address, :doc, "s3://BUCKET/PREFIX/NAME"),
          path: [kind: :new, doc: "ROOT/NAME, or a folder with a slash at its end"]
        ],
        examples: ["situ store pull s3://lab/recordings/lobby recordings/"],
        run: fn %{address: address, path: path}, opts ->
          run_transfer("pull", opts, &S3.pull(address, path, progress: &1))
        end
      },
      %Verb{
        words: ["store", "sync"],
        summary: "copy all finished recordings that are missing to or from object storage (S3)",
        about:
          """
          One of the two is an address. Recordings that are being written are left out until they are finished, so this
          command can run every few minutes next to a recorder. With --keep, it deletes remote recordings of a name when
          later ones of the name are that much newer; the newest is never deleted.
          """ <> @credentials,
        arguments: [
          from: [kind: :text, doc: "a folder or an address"],
          to: [kind: :text, doc: "an address or a folder"]
        ],
        options: [
          Option.new(:keep, :span, "delete remote recordings that are older than this (30d)")
        ],
        examples: [
          "situ store sync recordings s3://lab/recordings --keep 720h",
          "situ store sync s3://lab/recordings copies"
        ],
        run: fn %{from: from, to: to}, opts ->
          run_transfer("sync", opts, &S3.sync(from, to, progress: &1, keep: opts[:keep]))
        end
      }
    ]
  end

  defp run_transfer(label, opts, transfer) do
    started = System.monotonic_time(:millisecond)
    report = TransferProgress.with_progress(label, opts, transfer) |> Error.unwrap!()
    seconds = (System.monotonic_time(:millisecond) - started) / 1000
    if opts[:json], do: Output.print_json(report), else: print_report(report, seconds)
    0
  end

  defp print_report(report, seconds) do
    for name <- report.copied, do: Output.puts("copied   #{Output.format_name(name)}")
    for name <- report.deleted, do: Output.puts("deleted  #{Output.format_name(name)}")

    for path <- report.unfinished,
        do: Output.puts("not finished, left out  #{Output.format_name(path)}")

    Output.puts(
      "#{length(report.copied)} copied, #{length(report.present)} were there already, in #{Float.round(seconds, 1)} s"
    )

    Output.puts(format_cost(report.cost))
  end

  @doc """
  Describes the cost of a transfer.

      iex> cost = %{reads: 1, writes: 20, deletes: 0, sent: 5_000_000, received: 0}
      iex> Situ.CLI.Store.ObjectStorage.format_cost(cost)
      "cost: 20 requests that write or list, 1 request that reads; 5.0 MB sent, 0 B received"
  """
  @spec format_cost(map()) :: String.t()
  def format_cost(cost) do
    deletes =
      if cost.deletes > 0, do: ", #{Output.format_count(cost.deletes, "deletion")}", else: ""

    "cost: #{format_requests(cost.writes, "write or list", "writes or lists")}, " <>
      "#{format_requests(cost.reads, "read", "reads")}#{deletes}; " <>
      "#{Output.format_bytes(cost.sent)} sent, #{Output.format_bytes(cost.received)} received"
  end

  defp format_requests(1, _plural, singular), do: "1 request that #{singular}"
  defp format_requests(count, plural, _singular), do: "#{count} requests that #{plural}"
end
