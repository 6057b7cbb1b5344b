defmodule Situ.Store.S3.ManifestTest do
  use ExUnit.Case, async: true
  alias Situ.Error
  alias Situ.Store.S3.Manifest

  @block Manifest.block_size()
  @address "s3://lab/lobby.0000"

  defp manifest do
    sums = <<1::32, 2::32>>

    %Manifest{
      name: "lobby.0000",
      id: String.duplicate("ab", 16),
      created: 5,
      first: -1,
      last: 7,
      bytes: 100,
      files: [
        %{name: "data-000000.situ", size: @block + 1, etag: "e", crc: :erlang.crc32(sums)}
      ],
      parts: [
        {:index, "index"},
        {:sums, "data-000000.situ", sums},
        {:blocks, "data-000000.situ", 1, "x"}
      ]
    }
  end

  defp encode(manifest), do: manifest |> Manifest.encode() |> IO.iodata_to_binary()

  test "decodes what was encoded" do
    assert Manifest.decode(encode(manifest()), @address) == {:ok, manifest()}
  end

  test "rejects names, checksums and blocks that do not fit" do
    file = hd(manifest().files)

    for bad <- [
          %{manifest() | id: "../../etc"},
          %{manifest() | files: [%{file | name: "../data-000000.situ"}]},
          %{manifest() | files: [%{file | size: -1}]},
          %{manifest() | files: [%{file | crc: 0}]},
          %{manifest() | parts: Enum.take(manifest().parts, 1)},
          %{manifest() | parts: tl(manifest().parts)},
          %{manifest() | parts: manifest().parts ++ [{:blocks, file.name, 1, "too long"}]},
          %{manifest() | parts: manifest().parts ++ [{:blocks, "data-000009.situ", 0, "x"}]}
        ] do
      assert {:error, %Error{code: :not_a_store}} = Manifest.decode(encode(bad), @address)
    end
  end

  test "no damaged or truncated manifest raises an error" do
    bytes = encode(manifest())

    for at <- 0..(byte_size(bytes) - 1) do
      <<head::binary-size(at), byte, rest::binary>> = bytes
      changed = <<head::binary, Bitwise.bxor(byte, 0x20), rest::binary>>
      assert elem(Manifest.decode(changed, @address), 0) in [:ok, :error]
      assert {:error, %Error{}} = Manifest.decode(head, @address)
    end
  end
end
