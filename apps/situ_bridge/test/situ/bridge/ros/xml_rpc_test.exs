defmodule Situ.Bridge.Ros.XmlRpcTest do
  # Not async, because it counts atoms.
  use ExUnit.Case, async: false
  alias Situ.Bridge.Ros.{SlaveCall, TcpRos, XmlRpc}
  doctest XmlRpc
  doctest TcpRos
  doctest SlaveCall

  @values [
    1,
    -5,
    1.5,
    true,
    false,
    "",
    "a <b> & c",
    "ä",
    [],
    [1, ["x"]],
    %{},
    %{"a" => [1], "b" => %{}},
    {:bytes, <<0, 255>>},
    nil
  ]

  test "decodes every encoded value" do
    document = IO.iodata_to_binary(XmlRpc.encode_response(@values))
    assert XmlRpc.read_response(document) == {:ok, @values}
  end

  test "reads Python's documents" do
    document = """
    <?xml version='1.0'?>
    <methodResponse>
    <params>
    <param>
    <value><array><data>
    <value><int>1</int></value>
    <value><string>current topics</string></value>
    <value><array><data>
    <value>bare</value>
    </data></array></value>
    </data></array></value>
    </param>
    </params>
    </methodResponse>
    """

    assert XmlRpc.read_response(document) == {:ok, [1, "current topics", ["bare"]]}

    struct = "<struct><member><name>faultCode</name><value><int>1</int></value></member></struct>"
    fault = "<methodResponse><fault><value>#{struct}</value></fault></methodResponse>"

    assert {:error, "the server refused" <> _} = XmlRpc.read_response(fault)
  end

  test "does not expand entities, and limits nesting" do
    bomb =
      ~s(<!DOCTYPE x [<!ENTITY a "aaaa">]><methodCall><methodName>&a;</methodName></methodCall>)

    assert {:error, _} = XmlRpc.read_request(bomb)
    deep = String.duplicate("<array><data><value>", 1_000)
    assert {:error, _} = XmlRpc.read_response("<methodResponse><params><param><value>" <> deep)
  end

  test "reads or rejects mutated documents and headers, and creates no atoms" do
    request = IO.iodata_to_binary(XmlRpc.encode_request("m", @values))
    header = IO.iodata_to_binary(TcpRos.encode_header(%{"topic" => "/a", "md5sum" => "*"}))
    :rand.seed(:exsss, {1, 2, 3})
    change = fn -> change(request, header) end
    # The first mutations load all modules, whose atoms must not count.
    for _ <- 1..500, do: change.()
    atoms = :erlang.system_info(:atom_count)
    for _ <- 1..4_000, do: change.()
    assert :erlang.system_info(:atom_count) - atoms < 1_000
  end

  defp change(request, header) do
    document = mutated(request, :rand.uniform(100_000), :rand.uniform(256) - 1)

    case XmlRpc.read_request(document) do
      {:ok, method, arguments} -> assert is_binary(method) and is_list(arguments)
      {:error, why} -> assert is_binary(why)
    end

    assert {:error, _} =
             document
             |> binary_part(0, :rand.uniform(byte_size(document)) - 1)
             |> XmlRpc.read_response()

    assert header
           |> mutated(:rand.uniform(100_000), :rand.uniform(256) - 1)
           |> TcpRos.read_header() != nil
  end

  defp mutated(bytes, at, byte) do
    at = rem(at, byte_size(bytes))
    <<before::binary-size(at), _, rest::binary>> = bytes
    before <> <<byte>> <> rest
  end
end
