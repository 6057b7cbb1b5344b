defmodule Situ.Link.AddressTest do
  # The name server is configured in the application's environment, so this is not async.
  use ExUnit.Case, async: false
  alias Situ.Link.{Address, Server}
  doctest Address

  @moduletag :tmp_dir

  # A DNS server with one zone that responds over UDP: `records` of `_situ._tcp.NAME`.
  defp name_server(records) do
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(socket)
    pid = spawn_link(fn -> answer(socket, records) end)
    :ok = :gen_udp.controlling_process(socket, pid)
    Application.put_env(:situ_link, :nameservers, [{{127, 0, 0, 1}, port}])
    on_exit(fn -> Application.delete_env(:situ_link, :nameservers) end)
  end

  defp answer(socket, records) do
    with {:ok, {ip, port, query}} <- :gen_udp.recv(socket, 0) do
      {:ok, asked} = :inet_dns.decode(query)
      [question] = :inet_dns.msg(asked, :qdlist)
      name = :inet_dns.dns_query(question, :domain)

      found =
        for data <- Map.get(records, to_string(name), []),
            do: :inet_dns.make_rr(domain: name, type: :srv, class: :in, ttl: 1, data: data)

      id = asked |> :inet_dns.msg(:header) |> :inet_dns.header(:id)
      # 3: the name does not exist.
      code = if found == [], do: 3, else: 0
      flags = [qr: true, aa: true, rd: true, ra: true, opcode: :query, rcode: code]
      header = :inet_dns.make_header([id: id] ++ flags)
      reply = :inet_dns.make_msg(header: header, qdlist: [question], anlist: found)
      :ok = :gen_udp.send(socket, ip, port, :inet_dns.encode(reply))
      answer(socket, records)
    end
  end

  defp resolve(text, names \\ %{}) do
    with {:ok, address} <- Address.parse(text), do: Address.resolve(address, names)
  end

  test "a DNS service gives host and port by lowest priority, then highest weight" do
    records = [{20, 99, 1, ~c"c.lab"}, {10, 1, 2, ~c"a.lab"}, {10, 5, 3, ~c"b.lab"}]
    name_server(%{"_situ._tcp.lab1" => records})
    assert {:ok, %{host: "b.lab", port: 3, name: "lobby"}} = resolve("situ://lab1/lobby")
    # An explicit port, a configured name, an IP address and a name unknown to DNS do not change.
    assert {:ok, %{host: "lab1", port: 4_000}} = resolve("situ://lab1:4000/lobby")
    names = %{"lab1" => "situs://10.0.0.3:11500"}
    assert {:ok, %{transport: :tls, port: 11_500}} = resolve("situ://lab1/lobby", names)
    assert {:ok, %{host: "10.0.0.9", port: 11_411}} = resolve("situ://10.0.0.9/lobby")
    assert {:ok, %{host: "lab2", port: 11_411}} = resolve("situ://lab2/lobby")
  end

  test "a link opens by a name that only DNS knows", %{tmp_dir: root} do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Situ.Store.create(p, "lobby", root)
          p |> Situ.from_enumerable(1..3, every: 10) |> Situ.Store.write(store, "n")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    {:ok, server} = Situ.Link.serve(Path.join(root, "lobby"), port: 0)
    name_server(%{"_situ._tcp.robot" => [{1, 1, Server.port(server), ~c"localhost"}]})

    assert Situ.to_list(fn p ->
             p |> Situ.Link.open("situ://robot/lobby", from: :start) |> Situ.Link.stream("n")
           end) == [1, 2, 3]

    Server.close(server)
  end
end
