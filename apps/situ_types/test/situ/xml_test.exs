defmodule Situ.XmlTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Xml
  alias Situ.Xml

  test "rejects document types in every encoding before it reads their entities" do
    bomb = ~s(<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><x>&b;</x>)
    external = ~s(<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><x>&a;</x>)
    outside = ~s(<!DOCTYPE x SYSTEM "file:///etc/passwd"><x/>)
    wide = :unicode.characters_to_binary("\uFEFF" <> bomb, :utf8, {:utf16, :big})

    for document <- [bomb, external, outside, wide] do
      assert {:error, why} = Xml.parse(document)
      assert why =~ "document type"
    end
  end

  test "limits the depth of elements" do
    nest = fn depth -> String.duplicate("<a>", depth) <> String.duplicate("</a>", depth) end
    assert {:ok, {"a", %{}, [_]}} = Xml.parse(nest.(200))
    assert {:error, why} = Xml.parse(nest.(201))
    assert why =~ "nested too deeply"
  end

  test "reads a byte order mark, comments, CDATA, long texts and other encodings" do
    long = String.duplicate("1.5 ", 100_000)
    assert {:ok, {"a", %{}, [^long]}} = Xml.parse("\uFEFF<!-- x --><a>#{long}</a>\n<!-- y -->\n")
    assert {:ok, {"a", %{}, [_ | _]} = element} = Xml.parse("<a>b<![CDATA[<c>]]>d</a>")
    assert Xml.text_content(element) == "b<c>d"
    latin = ~s(<?xml version="1.0" encoding="iso-8859-1"?><a>) <> <<0xE4>> <> "</a>"
    assert {:ok, {"a", %{}, ["ä"]}} = Xml.parse(latin)
    assert {:ok, {"a", %{}, [{"b", %{}, []}]}} = Xml.parse("<a> <b>c</b> </a>", texts: false)
  end

  test "describes malformed documents" do
    for document <- ["", "x", "<a>", "<a></b>", "<a b=c/>", "<a>&b;</a>", <<"<a>", 0xFF, "</a>">>] do
      assert {:error, why} = Xml.parse(document)
      assert why =~ "not well-formed XML", why
    end
  end

  property "parses an escaped text back, and survives any bytes" do
    forall {text, bytes} <- {ascii_text(), binary()} do
      assert {:ok, element} = Xml.parse("<a>#{Xml.escape(text)}</a>")
      assert Xml.text_content(element) == text
      assert match?({:error, _}, Xml.parse(bytes)) or match?({:ok, _}, Xml.parse(bytes))
    end
  end
end
