# The processes of test/link/run: a recorder, a server and receivers, which the script kills at
# any time.
defmodule Situ.LinkTest.Links do
  alias Situ.{Message, Link, Store}
  alias Situ.Store.Writer

  # Appends messages 1, 2 ... to a new version of `lobby`, starting after the last version, until
  # there are `total`.
  def record(root, total) do
    last = root |> counted() |> List.last() || 0
    {:ok, writer} = Writer.create("lobby", root)
    {:ok, stream} = Writer.stream(writer, "n", type: :integer)
    say("recording from #{last + 1}")
    append(stream, last + 1, String.to_integer(total), root)
  end

  defp append(stream, next, total, _root) when next > total do
    {:ok, _} = Writer.close_stream(stream, total * 1_000)
    :ok = Writer.close(stream.writer)
    say("recorded")
  end

  defp append(stream, next, total, root) do
    last = min(next + 19, total)
    {:ok, stream} = Writer.append(stream, Enum.map(next..last, &message/1))
    Process.sleep(8)
    # The end is recorded only after all other tests.
    if last == total, do: wait_for(Path.join(root, "finish"))
    append(stream, last + 1, total, root)
  end

  defp message(n) do
    %Message{data: n, originating_time: n * 1_000, creation_time: n * 1_000 + 5, sequence_id: n}
  end

  defp wait_for(file) do
    if not File.exists?(file) do
      Process.sleep(20)
      wait_for(file)
    end
  end

  def serve(root, port) do
    opts = [port: String.to_integer(port), wait: true, token: "s3cret"]
    {:ok, server} = Link.serve(Path.join(root, "lobby"), opts)
    say("serving #{Link.Server.port(server)}")
    Process.sleep(:infinity)
  end

  # Copies the stream to its own recording, starting after the messages that are already there.
  def copy(port, root) do
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "copy", root)
        numbers = p |> open(port, {:after, Path.join(root, "copy")}) |> read()
        numbers |> Situ.first() |> Situ.each(fn _n -> say("copying") end)
        Store.write(numbers, store, "n")
      end)

    say("ended")
  end

  # Writes messages to a file and confirms them. After a kill, some arrive again, and none is
  # missing.
  def follow(port, root, name) do
    out = File.open!(Path.join(root, name), [:append])

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        link = open(p, port, :resume, Path.join(root, name <> ".json"))
        link |> read() |> Situ.each(&IO.binwrite(out, "#{&1}\n")) |> Link.confirm(link, "n")
      end)

    say("ended")
  end

  defp open(p, port, from, position \\ nil) do
    opts = [from: from, token: "s3cret", position: position, save_every: 50]
    Link.open(p, "situ://127.0.0.1:#{port}/lobby", opts)
  end

  defp read(link), do: Link.stream(link, "n", type: :integer)

  # Receives over TLS from another host, and prints the number of messages or the error. `root`
  # has signed the certificate.
  def trust(address, root) do
    numbers =
      Situ.to_list(fn p ->
        # The recorder was killed once, so messages are read from the first one on, in whichever
        # version it is.
        opts = [from: 0, token: "s3cret", tls: [cacertfile: root]]
        p |> Link.open(address, opts) |> read()
      end)

    say("came over: #{length(numbers)}")
  rescue
    error in Situ.Error ->
      say("refused #{error.code}: #{error.what}")
      System.halt(1)
  end

  def check(root, total) do
    total = String.to_integer(total)
    expected = Enum.to_list(1..total)
    copied = numbers(root, "copy")
    if copied != expected, do: fail("the copy", copied, expected)
    say("copy equal: #{length(copied)}")
  end

  def check_followed(root, name, total) do
    got =
      Path.join(root, name)
      |> File.read!()
      |> String.split("\n", trim: true)
      |> Enum.map(&String.to_integer/1)

    expected = Enum.to_list(1..String.to_integer(total))

    if Enum.uniq(Enum.sort(got)) != expected,
      do: fail("what was followed", Enum.sort(got), expected)

    say("followed all, #{length(got) - length(expected)} of them twice")
  end

  defp counted(root), do: numbers(root, "lobby")

  defp numbers(root, name) do
    for path <- Enum.sort(Store.list(root)),
        Path.basename(path) =~ name <> ".",
        {:ok, store} = Store.open(path),
        Store.has_stream?(store, "n"),
        message <- Store.messages(store, "n"),
        do: message.data
  end

  defp fail(what, got, expected) do
    say(
      "#{what}: #{length(got)} of #{length(expected)}; missing #{inspect(expected -- got, limit: 10)}, " <>
        "twice #{inspect(got -- Enum.uniq(got), limit: 10)}"
    )

    System.halt(1)
  end

  defp say(text), do: IO.puts(text)
end

{:ok, _} = Application.ensure_all_started(:situ_link)
[role | arguments] = System.argv()
apply(Situ.LinkTest.Links, String.to_atom(role), arguments)
