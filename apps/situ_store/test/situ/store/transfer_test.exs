defmodule Situ.Store.TransferTest do
  # Data copied from store to store stays unchanged, whether its types are known or not.
  use ExUnit.Case, async: true
  import Situ.Store.Test.Record
  alias Situ.Store
  alias Situ.Store.Test.{Picture, Raw, Sound}
  alias Situ.Store.Undecoded

  @moduletag :tmp_dir

  # {"never_heard_of_this_atom", 1} with an atom that no system knows; 119 is the tag of a small atom.
  @foreign <<131, 104, 2, 119, 25, "never_heard_of_this_at0m_", 97, 1>>

  defp data(path, stream),
    do: path |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)

  defp holds?(path, bytes) do
    path |> Path.join("data-*") |> Path.wildcard() |> Enum.any?(&(File.read!(&1) =~ bytes))
  end

  defp makers(root) do
    [
      copy: &Store.copy(&1, {"copied", root}),
      crop: &Store.crop(&1, {"cropped", root}, start: 0),
      concat: &Store.concat([&1], {"joined", root}),
      edit: &Store.edit(&1, {"edited", root}, %{})
    ]
  end

  test "terms with unknown atoms are copied byte by byte", %{tmp_dir: root} do
    path = Raw.written(root, @foreign)
    assert data(path, "T") == [{"never_heard_of_this_at0m_", 1}]

    for {_, make} <- makers(root) do
      {:ok, made} = make.(path)
      assert holds?(made, @foreign)
      assert data(made, "T") == data(path, "T")
    end
  end

  test "data of an unknown codec is copied unchanged", %{tmp_dir: root} do
    pictures = for i <- 1..3, do: %Picture{width: i, data: :binary.copy(<<i>>, 40_000)}
    path = store(root, [{"Pic", messages(pictures), []}])

    module = ~s("Elixir.Situ.Store.Test.Picture")
    Raw.replace(path, module, String.replace(module, "Picture", "Pixture"))
    Raw.replace(path, ~s("test.picture"), ~s("test.unknown"))
    assert [%Undecoded{codec: "test.unknown"} | _] = data(path, "Pic")

    for {_, make} <- makers(root) do
      {:ok, made} = make.(path)
      assert data(made, "Pic") == data(path, "Pic")
    end
  end

  test "codecs from several stores get distinct numbers", %{tmp_dir: root} do
    other = %Picture{width: 9, data: "late"}

    a =
      store(
        root,
        [{"S", messages([%Sound{samples: [1]}, %Picture{width: 1, data: "a"}]), []}],
        "a"
      )

    b = store(root, [{"S", [message(other, 9_000_000)], []}], "b")
    {:ok, made} = Store.concat([a, b], {"ab", root})
    assert data(made, "S") == [%Sound{samples: [1]}, %Picture{width: 1, data: "a"}, other]
  end
end
