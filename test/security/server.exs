# The two studios that the probes attack, in one VM: one on loopback without a token, and one with
# a token. A control port replies to each line with the VM's memory, atoms, ports and processes.
# The VM ends with its standard input.
[work | _] = System.argv()
{:ok, _} = Application.ensure_all_started(:situ_studio)
alias Situ.Store.Writer

folder = Path.join(work, "recordings")
File.mkdir_p!(folder)
{:ok, writer} = Writer.create("Talk", folder)

for {name, value} <- [level: &(&1 / 10), words: &"word #{&1}", boxes: &%{"a" => &1, "b" => [&1]}] do
  {:ok, stream} = Writer.stream(writer, to_string(name))

  messages =
    for i <- 1..2_000 do
      %Situ.Message{
        data: value.(i),
        originating_time: i * 10_000_000,
        creation_time: i * 10_000_000,
        sequence_id: i
      }
    end

  {:ok, _} = Writer.append(stream, messages)
end

:ok = Writer.close(writer)

# Folders with links to themselves and to places outside the recordings.
for {name, target} <- [{"a", "."}, {"b", "."}, {"root", "/"}],
    do: File.ln_s!(target, Path.join(folder, name))

# A playlist that refers to another file, with the name of a video.
File.write!(
  Path.join(folder, "list.mp4"),
  "#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n#EXT-X-ENDLIST\n"
)

{:ok, open} = Situ.Studio.start_link(path: folder, port: 0, id: "open")

{:ok, closed} =
  Situ.Studio.start_link(path: folder, port: 0, id: "closed", token: "right-token-of-the-test")

{:ok, listener} = :gen_tcp.listen(0, [:binary, packet: :line, active: false, ip: {127, 0, 0, 1}])
{:ok, control} = :inet.port(listener)

numbers = fn ->
  Enum.each(Process.list(), &:erlang.garbage_collect/1)

  Situ.JSON.encode(%{
    memory: :erlang.memory(:total),
    atoms: :erlang.system_info(:atom_count),
    processes: :erlang.system_info(:process_count),
    ports: :erlang.system_info(:port_count)
  })
end

serve = fn serve ->
  {:ok, socket} = :gen_tcp.accept(listener)

  spawn(fn ->
    with {:ok, _} <- :gen_tcp.recv(socket, 0, 5_000),
         do: :gen_tcp.send(socket, [numbers.(), "\n"])

    :gen_tcp.close(socket)
  end)

  serve.(serve)
end

spawn(fn -> serve.(serve) end)
IO.puts("ready #{Situ.Studio.port(open)} #{Situ.Studio.port(closed)} #{control}")
Process.sleep(:infinity)
